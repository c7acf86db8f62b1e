"""RLlib: PPO, whose remote worker steps the native batch."""

import argparse

from ray.rllib.algorithms.ppo import PPOConfig  # pip install -e ".[rllib]"


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
        # Without gym_env_vectorize_mode, RLlib creates 8 environments and steps them one by one, with the same results.
        .env_runners(num_env_runners=1, num_envs_per_env_runner=8, gym_env_vectorize_mode="vector_entry_point")
        .training(train_batch_size=args.batch)
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    for _ in range(args.iterations):
        result = algorithm.train()["env_runners"]
        steps, score = result["num_env_steps_sampled_lifetime"], result.get("episode_return_mean", float("nan"))
        print(f"{steps:.0f} steps, mean return {score:.2f} cm")
    algorithm.stop()


if __name__ == "__main__":
    main()
