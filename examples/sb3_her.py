"""Stable-Baselines3: SAC with hindsight experience replay, towards goals on the paper's floor."""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.vec_env import VecNormalize

from capsule_gym.sb3 import CapsuleSB3VecEnv

STEPS = 100
TASK: dict[str, Any] = {
    "goal_env": True,
    "max_episode_steps": STEPS,
    "control_dt": 0.05,
    "randomization": "paper",
    "termination_penalty": 0.3,
}


def evaluate(model: SAC, env: VecNormalize) -> str:
    """The median distance from the goal at the end of 64 episodes without exploration, and the share of failures."""
    envs = gym.make_vec("capsule_gym:CapsuleGoal-v0", num_envs=64, autoreset_mode="DISABLED", **TASK)
    # These seeds are far from those of training.
    observations, _ = envs.reset(seed=1_000_000)
    for _ in range(STEPS):
        actions, _ = model.predict(env.normalize_obs(observations), deterministic=True)
        observations, _, terminated, _, info = envs.step(actions)
    return f"{100.0 * np.median(np.abs(info['error'])):.1f} cm from the goal, {terminated.mean():.0%} failed"


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    env = VecNormalize(CapsuleSB3VecEnv(64, args.seed, task="goal", **TASK), norm_reward=False)
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        # The terms of the reward for energy and termination do not depend on the goal; they are in the infos.
        replay_buffer_kwargs={"copy_info_dict": True},
        policy_kwargs={"net_arch": [64, 64]},
        # Hindsight needs whole episodes.
        learning_starts=64 * (STEPS + 1),
        gradient_steps=4,
        learning_rate=1e-3,
        gamma=0.97,
        ent_coef="auto_0.1",
        seed=args.seed,
        device="cpu",
    )
    print("before:", evaluate(model, env))
    model.learn(args.steps)
    print("after:", evaluate(model, env))


if __name__ == "__main__":
    main()
