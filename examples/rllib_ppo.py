"""RLlib: PPO with a remote worker."""

import argparse

from ray.rllib.algorithms.ppo import PPOConfig


def main() -> None:
    """Trains."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--batch", type=int, default=4000, help="steps of an iteration")
    args = parser.parse_args()

    config = (
        PPOConfig()
        # The prefix makes the worker import the package, which registers the environment.
        .environment("capsule_gym:CapsuleStickSlip-v0", env_config={"randomization": "paper"})
        .env_runners(num_env_runners=1, num_envs_per_env_runner=8)
        .training(train_batch_size=args.batch)
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    for _ in range(args.iterations):
        result = algorithm.train()["env_runners"]
        print(result["num_env_steps_sampled_lifetime"], "steps, mean return", result.get("episode_return_mean"))
    algorithm.stop()


if __name__ == "__main__":
    main()
