"""Best-known gaits of the direct-torque task: torque within 1.5 N m, |theta| < pi/2, N > 0, from rest over 33 s.

`data/archive.json` holds, for every plant of `baselines.archive.PLANTS` and every family of `baselines.gaits.families`,
the fastest gait that hours of CMA-ES found; the front of speed against cost of transport on the nominal plant; tolerant
gaits, with the largest slowest speed with M 10 % and mu about 20 % off; and the map of `gait-oracle`. Every gait is
robust: with M, mu and the first angle changed by 1 part in 1000, its speed changes by less than 1 %.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from baselines.archive import PLANTS, reading
from baselines.gaits import FOLDER
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import HORIZON

Act = Callable[[np.ndarray], np.ndarray]

# Rounding differs between machines, and a gait amplifies it up to this share of its speed.
TOLERANCE = 0.01


@dataclass(frozen=True, kw_only=True)
class Gait:
    """A gait and its performance.

    Attributes:
        M: mass of its plant's platform, kg.
        mu: friction coefficient of its plant.
        family: a name of `FAMILIES`.
        parameters: parameters in the order of the family.
        mean_speed: cm/s.
        cost_of_transport: integral |u theta_dot| dt / ((M + m) g distance).
        sensitivity: largest relative change of the mean speed for changes of 1 part in 1000.
        worst_speed: of a tolerant gait, the slowest mean speed with M 10 % and mu about 20 % off, cm/s; else None.
    """

    M: float
    mu: float
    family: str
    parameters: tuple[float, ...]
    mean_speed: float
    cost_of_transport: float
    sensitivity: float
    worst_speed: float | None = None

    @property
    def key(self) -> tuple[str, float, float, bool]:
        """Family, plant and whether the gait is tolerant: the archive holds one gait of each key."""
        return self.family, self.M, self.mu, self.worst_speed is not None

    def dominates(self, other: Gait) -> bool:
        """Whether the gait is no slower and has no larger cost of transport than another."""
        return self.mean_speed >= other.mean_speed and self.cost_of_transport <= other.cost_of_transport


@dataclass(frozen=True)
class GaitMap:
    """The gait that `gait-oracle` uses on every plant: a table over cells in M and log(mu).

    Attributes:
        M: centres of the cells, kg, ascending.
        mu: centres of the cells, ascending.
        gaits: the gaits of the cells.
        cells: the index of the gait of each cell, shape (len(M), len(mu)).
    """

    M: tuple[float, ...] = ()
    mu: tuple[float, ...] = ()
    gaits: tuple[Gait, ...] = ()
    cells: tuple[tuple[int, ...], ...] = ()

    def find(self, M: np.ndarray, mu: np.ndarray) -> list[Gait]:
        """The gaits of plants, from the nearest cells in M and log(mu)."""
        rows = np.abs(M[:, None] - np.array(self.M)).argmin(axis=1)
        columns = np.searchsorted(self.edges(), mu * mu)
        return [self.gaits[self.cells[i][j]] for i, j in zip(rows, columns, strict=True)]

    def edges(self) -> np.ndarray:
        """The squares of mu between the cells: the midpoint in log(mu) is the square root of a product."""
        return np.multiply(self.mu[:-1], self.mu[1:])


@dataclass(frozen=True)
class Archive:
    """The gaits by `Gait.key`, the front of the nominal plant, and the map of `gait-oracle`."""

    gaits: dict[tuple[str, float, float, bool], Gait] = field(default_factory=dict)
    front: tuple[Gait, ...] = ()
    oracle: GaitMap = GaitMap()

    def of_plant(self, M: float, mu: float, *, tolerant: bool = False) -> list[Gait]:
        """The gaits of one plant, the fastest first; tolerant ones by their worst speed."""
        found = [g for g in self.gaits.values() if (g.M, g.mu, g.worst_speed is not None) == (M, mu, tolerant)]
        return sorted(found, key=lambda g: -(g.mean_speed if g.worst_speed is None else g.worst_speed))

    def fastest(self) -> dict[tuple[float, float], Gait]:
        """The fastest gait of every plant that has one."""
        return {plant: found[0] for plant in PLANTS if (found := self.of_plant(*plant))}

    def everything(self) -> list[Gait]:
        """All gaits, those of the front included."""
        return [*(self.gaits[key] for key in sorted(self.gaits)), *self.front]


def load_archive(folder: Path = FOLDER) -> Archive:
    """Reads the archive of a folder, or returns an empty one if the folder contains none.

    Raises:
        ValueError: if the file is malformed.
    """
    with reading(folder, "python -m baselines.gaits") as (content, _):
        if not content:
            return Archive()
        gaits = {gait.key: gait for gait in (Gait(**fields) for fields in content["gaits"])}
        used = tuple(gaits[key] for key in content["oracle"]["gaits"])
        front = tuple(Gait(**fields) for fields in content["front"])
        archive = Archive(gaits, front, GaitMap(**{**content["oracle"], "gaits": used}))
        for gait in archive.everything():
            if len(gait.parameters) != FAMILIES[gait.family].parameters:
                raise ValueError(f"a gait of {gait.family!r} with {len(gait.parameters)} parameters")
        return archive


@lru_cache(maxsize=1)
def known_gaits() -> Archive:
    """The archived gaits, read once."""
    return load_archive()


def tolerant_nominal() -> Gait:
    """The tolerant gait of the nominal plant; the fastest one fails where M is 5 % off."""
    return known_gaits().of_plant(NOMINAL.M, NOMINAL.mu, tolerant=True)[0]


def encode_gaits(gaits: Sequence[Gait]) -> np.ndarray:
    """Encodes gaits of any families; see `encode`."""
    return np.concatenate([encode(gait.family, np.array([gait.parameters])) for gait in gaits])


def start_nominal(seeds: Sequence[int]) -> Act:
    """The policy `gait-nominal`: the tolerant gait of the nominal plant, on every plant."""
    gaits, steps = encode_gaits([tolerant_nominal()] * len(seeds)), count()
    return lambda observations: actions(gaits, next(steps) * GAIT_DT, observations)


def start_oracle(seeds: Sequence[int]) -> Act:
    """The policy `gait-oracle`: the gait that was fastest around each plant; M and mu are observed last."""
    gait_map, steps = known_gaits().oracle, count()
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


def pareto_front() -> list[Gait]:
    """The gaits of the nominal plant that no other gait dominates, the slowest first."""
    archive = known_gaits()
    candidates = [*archive.front, *archive.of_plant(NOMINAL.M, NOMINAL.mu)]
    kept = [gait for gait in candidates if not any(g.dominates(gait) for g in candidates if g != gait)]
    return sorted(dict.fromkeys(kept), key=lambda gait: gait.mean_speed)


def check(archive: Archive) -> list[str]:
    """Simulates every gait again; returns one line for each difference from the archive above the tolerance."""
    from capsule_gym import CapsuleVectorEnv

    gaits, steps = archive.everything(), round(HORIZON / GAIT_DT)
    options: dict[str, Any] = {"randomization": "none", "autoreset_mode": "DISABLED", "threads": os.cpu_count() or 1}
    env = CapsuleVectorEnv(len(gaits), control_dt=GAIT_DT, max_episode_steps=steps, **options)
    plants = {name: np.array([getattr(gait, name) for gait in gaits]) for name in ("M", "mu")}
    observations, _ = env.reset(seed=0, options=plants)
    encoded = encode_gaits(gaits)
    for step in range(steps):
        observations, *_ = env.step(actions(encoded, step * GAIT_DT, observations))
    metrics, stale = env.episode_metrics(), []
    env.close()
    for i, gait in enumerate(gaits):
        for metric in ("mean_speed", "cost_of_transport"):
            old, new = getattr(gait, metric), float(metrics[metric][i])
            if not abs(new - old) <= TOLERANCE * abs(old):
                stale.append(f"{gait.family} at M={gait.M}, mu={gait.mu}: {metric} is {old:.6g} on file, {new:.6g} now")
    return stale
