"""skrl: PPO on the native batch."""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG  # pip install -e ".[skrl]"
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

LAYERS = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "tanh"}]


class TimeLimitPPO(PPO):
    """Takes the value of an episode's last observation where the time limit truncates it.

    With SAME_STEP, a step returns the first observation of the next episode, whose value skrl would
    take.
    """

    def record_transition(
        self, *, next_observations: torch.Tensor, infos: dict[str, Any], **transition: Any
    ) -> None:
        """Records the last observations of the episodes that end."""
        if "final_obs" in infos:
            ended = np.flatnonzero(infos["_final_obs"])
            last = torch.as_tensor(np.stack(infos["final_obs"][ended]))
            next_observations = next_observations.clone()
            next_observations[ended] = last.to(next_observations)
        super().record_transition(next_observations=next_observations, infos=infos, **transition)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000, help="of each environment")
    args = parser.parse_args()

    env_id = "capsule_gym:CapsuleStickSlip-v0"
    env = wrap_env(gym.make_vec(env_id, num_envs=64, autoreset_mode="SAME_STEP"))
    spaces = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    models = {
        "policy": gaussian_model(**spaces, network=LAYERS, output="ACTIONS"),
        "value": deterministic_model(**spaces, network=LAYERS, output="ONE"),
    }
    cfg = PPO_CFG(time_limit_bootstrap=True)
    memory = RandomMemory(memory_size=cfg.rollouts, num_envs=env.num_envs, device=env.device)
    agent = TimeLimitPPO(models=models, memory=memory, cfg=cfg, **spaces)
    budget = {"timesteps": args.steps, "headless": True}
    SequentialTrainer(env=env, agents=agent, cfg=budget).train()
