"""Unmodified Stable-Baselines3: PPO with its default hyperparameters, and its learning curve."""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO  # pip install -e ".[sb3]"
from stable_baselines3.common.callbacks import BaseCallback

from capsule_gym.evaluation.episodes import evaluate, validation_set

ID = "capsule_gym:CapsuleStickSlip-v0"
# The law counteracts a residual torque; the total torque is easier to learn.
TASKS: dict[str, dict[str, Any]] = {
    "direct": {},
    "residual": {"controller": "baselines:adaptive", "residual_limit": 3.0, "total_torque": True},
}


class LearningCurve(BaseCallback):
    """Evaluates the deterministic policy on 16 plants, and prints speed and share of failures."""

    def __init__(self, task: str, steps_between: int) -> None:
        super().__init__()
        self.task = task
        self.steps_between = steps_between
        # These seeds are far from those of training.
        self.plants = validation_set(
            randomization="paper", name="validation", first_seed=1_000_000, count=16
        )

    def _on_step(self) -> bool:
        steps = self.num_timesteps
        if steps % self.steps_between == 0:
            episodes = evaluate(self.model, self.plants, env_kwargs=TASKS[self.task])
            speed = np.mean([episode["mean_speed"] for episode in episodes])
            failed = np.mean([episode["failed"] for episode in episodes])
            print(f"{steps:,} steps: {speed:.2f} cm/s, {failed:.0%} failed", flush=True)
        return True


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("task", choices=TASKS)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--steps", type=int, default=1_000_000)
parser.add_argument("--every", type=int, default=50_000, help="steps between evaluations")
args = parser.parse_args()

model = PPO("MlpPolicy", gym.make(ID, **TASKS[args.task]), seed=args.seed, device="cpu")
model.learn(args.steps, callback=LearningCurve(args.task, args.every))
