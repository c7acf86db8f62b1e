"""d3rlpy: behaviour cloning and IQL on the data of offline_data.py, evaluated on the frozen set `paper`.

MINARI_DATASETS_PATH=runs/data python examples/offline_rl.py --quality mixed
"""

import argparse

import d3rlpy  # pip install -e ".[d3rlpy]"
import minari
import numpy as np
from d3rlpy.algos import BCConfig, IQLConfig
from d3rlpy.dataset import MDPDataset
from d3rlpy.preprocessing import MultiplyRewardScaler, StandardObservationScaler

import capsule_gym


def load(quality: str) -> MDPDataset:
    """Converts a Minari dataset for d3rlpy, without each episode's last observation, which no action follows.

    d3rlpy's own `get_minari` keeps it, and so pairs the actions of later episodes with earlier observations.
    """
    episodes = list(minari.load_dataset(f"capsule/{quality}-v0"))
    return MDPDataset(
        observations=np.concatenate([episode.observations[:-1] for episode in episodes]),
        actions=np.concatenate([episode.actions for episode in episodes]),
        rewards=np.concatenate([episode.rewards for episode in episodes]),
        terminals=np.concatenate([episode.terminations for episode in episodes]),
        timeouts=np.concatenate([episode.truncations for episode in episodes]),
    )


def main() -> None:
    """Trains and evaluates both algorithms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quality", default="mixed")
    parser.add_argument("--steps", type=int, default=5000, help="of each algorithm")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    dataset = load(args.quality)
    scaled = {"observation_scaler": StandardObservationScaler(), "batch_size": 256}
    rates = {"actor_learning_rate": 1e-3, "critic_learning_rate": 1e-3}
    algorithms = {
        "BC": BCConfig(learning_rate=1e-3, **scaled),
        "IQL": IQLConfig(reward_scaler=MultiplyRewardScaler(0.1), **rates, **scaled),
    }
    for name, config in algorithms.items():
        d3rlpy.seed(args.seed)
        algorithm = config.create(device="cpu:0")
        algorithm.fit(
            dataset,
            n_steps=args.steps,
            n_steps_per_epoch=args.steps,
            logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
            show_progress=False,
        )
        episodes = capsule_gym.evaluate(algorithm.predict, "paper")
        speed, failed = (np.array([episode[metric] for episode in episodes]) for metric in ("mean_speed", "failed"))
        result = f"{speed.mean():.1f} cm/s, {failed.sum():.0f} of {len(episodes)} episodes failed"
        print(f"{args.quality}, {name}: {result}", flush=True)


if __name__ == "__main__":
    main()
