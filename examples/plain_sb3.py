"""Stable-Baselines3 as it is: PPO with its default hyperparameters on one environment, and its learning curve."""

import argparse
import csv
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

ID = "capsule_gym:CapsuleStickSlip-v0"
# Starts of training: theta within 60 degrees, theta_dot within 8 rad/s.
TASKS: dict[str, dict[str, Any]] = {
    "direct": {"initial_range": None},
    "residual": {"controller": "baselines:adaptive", "residual_limit": 3.0, "initial_range": (1.047, 8.0)},
}


class LearningCurve(BaseCallback):
    """Evaluates the deterministic policy on 16 plants, from the default start.

    Attributes:
        points: steps, mean speed (cm/s), and share of episodes that failed.
    """

    def __init__(self, every: int, **kwargs: Any) -> None:
        super().__init__()
        self.every, self.points = every, list[tuple[int, float, float]]()
        kwargs |= {"initial_range": None, "autoreset_mode": "DISABLED"}
        self.envs: Any = gym.make_vec(ID, num_envs=16, **kwargs)

    def _on_step(self) -> bool:
        if self.num_timesteps % self.every == 0:
            # Far from the seeds of training.
            observations, _ = self.envs.reset(seed=1_000_000)
            ended = np.zeros(16, bool)
            while not ended.all():
                actions, _ = self.model.predict(observations, deterministic=True)
                observations, _, terminated, truncated, _ = self.envs.step(actions)
                ended = terminated | truncated
            metrics = self.envs.episode_metrics()
            speed, failed = metrics["mean_speed"].mean(), metrics["failed"].mean()
            self.points.append((self.num_timesteps, speed, failed))
            print(f"{self.num_timesteps:,} steps: {speed:.2f} cm/s, {failed:.0%} failed", flush=True)
        return True


def main() -> None:
    """Trains, and appends the curve to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task", choices=TASKS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--every", type=int, default=50_000, help="steps between evaluations")
    parser.add_argument("--curve", type=Path, help="CSV file")
    args = parser.parse_args()

    curve = LearningCurve(args.every, **TASKS[args.task])
    model = PPO("MlpPolicy", gym.make(ID, **TASKS[args.task]), seed=args.seed, device="cpu")
    model.learn(args.steps, callback=curve)
    if args.curve:
        with args.curve.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows((args.task, args.seed, *point) for point in curve.points)


if __name__ == "__main__":
    main()
