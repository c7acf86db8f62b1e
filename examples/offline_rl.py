"""d3rlpy: behaviour cloning and IQL on the data of offline_data.py, evaluated on the frozen set
`paper`.

MINARI_DATASETS_PATH=runs/data python examples/offline_rl.py --quality mixed
"""

import argparse

import d3rlpy  # pip install -e ".[d3rlpy]"
import minari
import numpy as np
from d3rlpy.algos import BCConfig, IQLConfig
from d3rlpy.preprocessing import StandardObservationScaler

import capsule_gym

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--quality", default="mixed")
parser.add_argument("--steps", type=int, default=5000, help="of each algorithm")
args = parser.parse_args()

episodes = list(minari.load_dataset(f"capsule/{args.quality}-v0"))
# d3rlpy's own `get_minari` keeps each episode's last observation, which no action follows, and so
# pairs the actions of later episodes with earlier observations.
dataset = d3rlpy.dataset.MDPDataset(
    observations=np.concatenate([episode.observations[:-1] for episode in episodes]),
    actions=np.concatenate([episode.actions for episode in episodes]),
    rewards=np.concatenate([episode.rewards for episode in episodes]),
    terminals=np.concatenate([episode.terminations for episode in episodes]),
    timeouts=np.concatenate([episode.truncations for episode in episodes]),
)
for config in (BCConfig, IQLConfig):
    algorithm = config(observation_scaler=StandardObservationScaler()).create()
    algorithm.fit(
        dataset, args.steps, args.steps, logger_adapter=d3rlpy.logging.NoopAdapterFactory()
    )
    evaluated = capsule_gym.evaluate(algorithm.predict, "paper")
    speed, failed = (
        np.mean([episode[name] for episode in evaluated]) for name in ("mean_speed", "failed")
    )
    print(
        f"{args.quality}, {config.__name__.removesuffix('Config')}: {speed:.1f} cm/s, {failed:.0%} failed",
        flush=True,
    )
