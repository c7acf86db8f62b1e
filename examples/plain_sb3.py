"""Unmodified Stable-Baselines3: PPO with its default hyperparameters on one environment, and its learning curve."""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

ID = "capsule_gym:CapsuleStickSlip-v0"
# The law counteracts a residual torque; the total torque is easier to learn.
TASKS: dict[str, dict[str, Any]] = {
    "direct": {},
    "residual": {"controller": "baselines:adaptive", "residual_limit": 3.0, "total_torque": True},
}


class LearningCurve(BaseCallback):
    """Evaluates the deterministic policy on 16 plants, and prints steps, cm/s and the share of failures."""

    def __init__(self, task: str, every: int) -> None:
        super().__init__()
        self.every = every
        self.envs: Any = gym.make_vec(ID, num_envs=16, autoreset_mode="DISABLED", **TASKS[task])

    def _on_step(self) -> bool:
        if self.num_timesteps % self.every == 0:
            # These seeds are far from those of training.
            observations, _ = self.envs.reset(seed=1_000_000)
            ended = np.zeros(16, bool)
            while not ended.all():
                actions, _ = self.model.predict(observations, deterministic=True)
                observations, _, terminated, truncated, _ = self.envs.step(actions)
                ended = terminated | truncated
            metrics = self.envs.episode_metrics()
            speed, failed = metrics["mean_speed"].mean(), metrics["failed"].mean()
            print(f"{self.num_timesteps:,} steps: {speed:.2f} cm/s, {failed:.0%} failed", flush=True)
        return True


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task", choices=TASKS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--every", type=int, default=50_000, help="steps between evaluations")
    args = parser.parse_args()

    curve = LearningCurve(args.task, args.every)
    model = PPO("MlpPolicy", gym.make(ID, **TASKS[args.task]), seed=args.seed, device="cpu")
    model.learn(args.steps, callback=curve)


if __name__ == "__main__":
    main()
