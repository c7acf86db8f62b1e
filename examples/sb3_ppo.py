"""Stable-Baselines3: PPO on the native batch, stepped in one compiled call."""

import argparse

from stable_baselines3 import PPO  # pip install -e ".[sb3]"
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from capsule_gym.sb3 import CapsuleSB3VecEnv


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    steps = parser.parse_args().steps

    env = VecNormalize(CapsuleSB3VecEnv(num_envs=64, seed=0), gamma=0.99)
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=1024, n_epochs=5, seed=0, device="cpu", verbose=1)
    model.learn(steps)

    env.training = env.norm_reward = False
    score, spread = evaluate_policy(model, env, n_eval_episodes=64)
    print(f"return of an episode: {score:.1f} +- {spread:.1f} cm")


if __name__ == "__main__":
    main()
