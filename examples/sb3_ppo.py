"""Stable-Baselines3: PPO on the native batch, stepped in one compiled call."""

import argparse

from stable_baselines3 import PPO  # pip install -e ".[sb3]"
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from capsule_gym.sb3 import CapsuleSB3VecEnv

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=1_000_000)
args = parser.parse_args()

env = VecNormalize(CapsuleSB3VecEnv(num_envs=64, seed=0))
model = PPO("MlpPolicy", env, n_steps=128, batch_size=1024, seed=0, device="cpu", verbose=1)
model.learn(args.steps)

env.training = False  # keeps the statistics of the observations
score, spread = evaluate_policy(model, env, n_eval_episodes=64)
print(f"return of an episode: {score:.1f} +- {spread:.1f} cm")
