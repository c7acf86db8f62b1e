"""The scripted policies `gait-nominal` and `gait-oracle`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count

import numpy as np

from baselines.gaits.archive import Gait, GaitMap, known_gaits
from baselines.gaits.families import GAIT_DT, actions, encode
from capsule_gym.parameters import NOMINAL

Act = Callable[[np.ndarray], np.ndarray]


def tolerant_nominal() -> Gait:
    """The tolerant gait of the nominal plant; the fastest one fails where M is 5 % off."""
    return known_gaits().of_plant(NOMINAL.M, NOMINAL.mu, tolerant=True)[0]


def oracle_map() -> GaitMap:
    """The committed map of `gait-oracle`.

    Raises:
        ValueError: if the archive holds none.
    """
    oracle = known_gaits().oracle
    if oracle is None:
        raise ValueError("the archive of gaits must hold the oracle's map: run `python -m baselines.gaits --minutes 0`")
    return oracle


def encode_gaits(gaits: Sequence[Gait]) -> np.ndarray:
    """Gaits as compiled code takes them; see `encode`."""
    return encode([gait.family for gait in gaits], [gait.parameters for gait in gaits])


def start_nominal(seeds: Sequence[int]) -> Act:
    """The tolerant gait of the nominal plant, on every plant."""
    gaits, steps = encode_gaits([tolerant_nominal()] * len(seeds)), count()
    return lambda observations: actions(gaits, next(steps) * GAIT_DT, observations)


def start_oracle(seeds: Sequence[int]) -> Act:
    """The gait that was fastest around each plant; M and mu are the last two observations."""
    gait_map, steps = oracle_map(), count()
    gaits, observed = np.empty(0), np.empty((len(seeds), 2), np.float32)

    def act(observations: np.ndarray) -> np.ndarray:
        nonlocal gaits
        plants = observations[:, -2:]
        # On most steps no plant has changed.
        if gaits.size == 0 or not np.array_equal(plants, observed):
            observed[:] = plants
            gaits = encode_gaits(gait_map.find(*plants.T.astype(np.float64)))
        return actions(gaits, next(steps) * GAIT_DT, observations)

    return act
