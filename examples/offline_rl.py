"""d3rlpy: behaviour cloning and IQL on the data of offline_data.py, evaluated on the set `paper`.

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
names = ("actions", "rewards", "terminations", "truncations")
columns = [np.concatenate([getattr(each, name) for each in episodes]) for name in names]
observations = np.concatenate([each.observations[:-1] for each in episodes])
dataset = d3rlpy.dataset.MDPDataset(observations, *columns)
quiet = d3rlpy.logging.NoopAdapterFactory()
for name, config in (("BC", BCConfig), ("IQL", IQLConfig)):
    algorithm = config(observation_scaler=StandardObservationScaler()).create()
    algorithm.fit(dataset, args.steps, args.steps, logger_adapter=quiet)
    evaluated = capsule_gym.evaluate(algorithm.predict, "paper")
    speed = np.mean([each["mean_speed"] for each in evaluated])
    failed = np.mean([each["failed"] for each in evaluated])
    print(f"{args.quality}, {name}: {speed:.1f} cm/s, {failed:.0%} failed", flush=True)
