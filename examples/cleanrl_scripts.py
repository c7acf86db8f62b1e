"""Runs CleanRL's scripts (PPO, SAC, TD3, ..), written for an older gymnasium, unchanged under
gymnasium 1.

python examples/cleanrl_scripts.py cleanrl/cleanrl/ppo_continuous_action.py --env-id
capsule_gym:CapsuleStickSlip-v0
"""

import functools
import os
import runpy
import sys
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv


class SameStep(SyncVectorEnv):
    """Reports the ends of episodes as gymnasium 0.29 did, which these scripts expect."""

    def __init__(self, env_fns: Any) -> None:
        super().__init__(env_fns, autoreset_mode=AutoresetMode.SAME_STEP)

    def step(self, actions: np.ndarray) -> Any:
        """Steps and returns the infos in gymnasium 0.29's format."""
        observations, rewards, terminated, truncated, info = super().step(actions)
        if "final_obs" in info:
            last = info["final_info"]["episode"]
            episodes = [
                {"episode": {name: last[name][i] for name in "rlt"}} for i in range(self.num_envs)
            ]
            info["final_observation"] = info["final_obs"]
            info["final_info"] = [
                episodes[i] if ended else None for i, ended in enumerate(info["_final_obs"])
            ]
        return observations, rewards, terminated, truncated, info


if __name__ == "__main__":
    wrapper = functools.partial(gym.wrappers.TransformObservation, observation_space=None)
    vars(gym.vector)["SyncVectorEnv"], vars(gym.wrappers)["TransformObservation"] = (
        SameStep,
        wrapper,
    )
    script, sys.argv = sys.argv[1], sys.argv[1:]
    sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(script))))
    runpy.run_path(script, run_name="__main__")
