"""Stable-Baselines3: SAC with hindsight experience replay moves the capsule to goals."""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import SAC, HerReplayBuffer

from capsule_gym.sb3 import CapsuleSB3VecEnv

TASK: dict[str, Any] = {"task": "goal", "goal_env": True, "max_episode_steps": 250}


def errors(model: SAC) -> np.ndarray:
    """Distances from the goal in m at the end of 64 episodes, without exploration."""
    envs = gym.make_vec("capsule_gym:CapsuleGoal-v0", num_envs=64, autoreset_mode="DISABLED", **TASK)
    # These seeds are far from those of training.
    observations, _ = envs.reset(seed=1_000_000)
    for _ in range(TASK["max_episode_steps"]):
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, _, _, info = envs.step(actions)
    return np.abs(info["error"])


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    env = CapsuleSB3VecEnv(num_envs=16, seed=args.seed, **TASK)
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        learning_starts=16 * TASK["max_episode_steps"],
        train_freq=4,
        gradient_steps=8,
        seed=args.seed,
        device="cpu",
    )
    before = np.median(errors(model))
    model.learn(args.steps)
    print(f"median distance from the goal: {100 * before:.1f} cm before, {100 * np.median(errors(model)):.1f} cm after")


if __name__ == "__main__":
    main()
