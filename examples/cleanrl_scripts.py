"""Runs CleanRL's scripts, written for an older gymnasium, unchanged under gymnasium 1.

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
            final: list[Any] = [None] * self.num_envs
            for i in np.flatnonzero(info["_final_obs"]):
                final[i] = {"episode": {name: last[name][i] for name in "rlt"}}
            info["final_observation"] = info["final_obs"]
            info["final_info"] = final
        return observations, rewards, terminated, truncated, info


if __name__ == "__main__":
    transform = functools.partial(gym.wrappers.TransformObservation, observation_space=None)
    vars(gym.vector)["SyncVectorEnv"] = SameStep
    vars(gym.wrappers)["TransformObservation"] = transform
    del sys.argv[0]
    # The scripts import the package in the folder above theirs.
    folder = os.path.dirname(os.path.abspath(sys.argv[0]))
    sys.path.insert(0, os.path.dirname(folder))
    runpy.run_path(sys.argv[0], run_name="__main__")
