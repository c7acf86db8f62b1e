"""Stable-Baselines3: TQC of sb3-contrib with hindsight experience replay, towards goals."""

import argparse
import math
from typing import Any

import gymnasium as gym
import numpy as np
from sb3_contrib import TQC
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.vec_env import VecNormalize

from capsule_gym.sb3 import CapsuleSB3VecEnv

ENVS, STEPS, DT = 32, 200, 0.02
# Standard deviation of the noise on the actions, and the time over which it is correlated, s.
NOISE, NOISE_TIME = 0.25, 0.25


def evaluate(model: TQC, env: VecNormalize) -> str:
    """The distances from the goal at the end of 64 episodes without exploration, and the share of failures."""
    envs = gym.make_vec("capsule_gym:CapsuleGoal-v0", num_envs=64, autoreset_mode="DISABLED", goal_env=True)
    # These seeds are far from those of training.
    observations, _ = envs.reset(seed=1_000_000)
    terminated = truncated = np.zeros(64, bool)
    while not (terminated | truncated).all():
        actions, _ = model.predict(env.normalize_obs(observations), deterministic=True)
        observations, _, terminated, truncated, info = envs.step(actions)
    errors = 100.0 * np.abs(info["error"])
    distances = f"median {np.median(errors):.1f} cm, mean {errors.mean():.1f} cm"
    return f"distance from the goal: {distances}; {terminated.mean():.0%} failed"


class Evaluation(BaseCallback):
    """Prints an evaluation every 20,000 steps."""

    def _on_step(self) -> bool:
        if self.num_timesteps % 20_000 < self.training_env.num_envs:
            assert isinstance(self.model, TQC) and isinstance(self.training_env, VecNormalize)
            print(f"{self.num_timesteps:9,} steps: {evaluate(self.model, self.training_env)}", flush=True)
        return True


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    # Short episodes from many angles and rates contain the fast swings that move the platform.
    options: dict[str, Any] = {"goal_env": True, "initial_range": (1.047, 8.0), "max_episode_steps": STEPS}
    env = VecNormalize(CapsuleSB3VecEnv(ENVS, args.seed, task="goal", **options), norm_reward=False)
    sigma = np.full(1, NOISE * math.sqrt(2.0 / NOISE_TIME))
    model = TQC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        # The terms of the reward for energy and termination do not depend on the goal; they are in the infos.
        replay_buffer_kwargs={"copy_info_dict": True},
        policy_kwargs={"net_arch": [64, 64], "n_quantiles": 10},
        top_quantiles_to_drop_per_net=0,
        action_noise=OrnsteinUhlenbeckActionNoise(np.zeros(1), sigma, theta=1.0 / NOISE_TIME, dt=DT),
        # Hindsight needs whole episodes.
        learning_starts=ENVS * (STEPS + 1),
        gradient_steps=8,
        learning_rate=1e-3,
        tau=0.005,
        # The rewards of a step are small, at most 0.08.
        ent_coef="auto_0.005",
        target_entropy=-3.0,
        seed=args.seed,
        device="cpu",
    )
    print("before:", evaluate(model, env))
    model.learn(args.steps, callback=Evaluation())
    print("after:", evaluate(model, env))


if __name__ == "__main__":
    main()
