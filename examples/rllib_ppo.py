"""RLlib: PPO, whose remote workers step native batches."""

import argparse

from ray.rllib.algorithms.ppo import PPOConfig  # pip install -e ".[rllib]"

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--iterations", type=int, default=100, help="of 4000 steps")
args = parser.parse_args()

algorithm = (
    PPOConfig()
    # The prefix makes the workers import the package, which registers the environment.
    .environment("capsule_gym:CapsuleStickSlip-v0", env_config={"randomization": "paper"})
    # Without gym_env_vectorize_mode, RLlib creates 8 environments and steps them one by one, with
    # the same results.
    .env_runners(num_envs_per_env_runner=8, gym_env_vectorize_mode="vector_entry_point")
    .build_algo()
)
for _ in range(args.iterations):
    result = algorithm.train()["env_runners"]
    steps = result["num_env_steps_sampled_lifetime"]
    print(f"{steps:.0f} steps, mean return {result['episode_return_mean']:.2f} cm")
