"""Best-known gaits of the direct-torque task: torque within 1.5 N m, |theta| < pi/2, N > 0, from rest over 33 s.

`data/archive.json` holds, for every plant of `baselines.archive.PLANTS` and every family of `baselines.gaits.families`,
the fastest gait that `python -m baselines.gaits` has found; the front of speed against cost of transport on the nominal
plant; tolerant gaits, which maximise the slowest speed with M 10 % and mu about 20 % off; and the map of `gait-oracle`.
A gait counts only if it is robust: with M, mu and the first angle changed by 1 part in 1000, its speed changes by less
than 1 %. An entry is replaced only by a better one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from itertools import count
from pathlib import Path

import numpy as np

from baselines.archive import PLANTS, reading, write_archive
from baselines.gaits import FOLDER
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from capsule_gym.parameters import NOMINAL

Act = Callable[[np.ndarray], np.ndarray]


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

    @property
    def score(self) -> float:
        """The speed by which gaits of one key are compared: a tolerant gait's worst, else the mean; cm/s."""
        return self.mean_speed if self.worst_speed is None else self.worst_speed

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


@dataclass
class Archive:
    """The results of the search.

    Attributes:
        gaits: fastest and tolerant gaits by `Gait.key`.
        front: gaits of the nominal plant, none of which dominates another, slowest first.
        oracle: the map of `gait-oracle`; empty before it has been computed.
        iterations: number of iterations of the search so far.
    """

    gaits: dict[tuple[str, float, float, bool], Gait] = field(default_factory=dict)
    front: list[Gait] = field(default_factory=list)
    oracle: GaitMap = GaitMap()
    iterations: int = 0

    def of_plant(self, M: float, mu: float, *, tolerant: bool = False) -> list[Gait]:
        """The gaits of one plant in descending order of `Gait.score`."""
        found = [g for g in self.gaits.values() if (g.M, g.mu, g.worst_speed is not None) == (M, mu, tolerant)]
        return sorted(found, key=lambda g: -g.score)

    def fastest(self) -> dict[tuple[float, float], Gait]:
        """The fastest gait of every plant that has one."""
        return {plant: found[0] for plant in PLANTS if (found := self.of_plant(*plant))}

    def everything(self) -> list[Gait]:
        """All gaits, those of the front included."""
        return [*(self.gaits[key] for key in sorted(self.gaits)), *self.front]

    def offer(self, gait: Gait) -> bool:
        """Keeps a gait if it moves forwards and beats the known one of its key; returns whether it was kept."""
        known = self.gaits.get(gait.key)
        if gait.score <= max(0.0, known.score if known else 0.0):
            return False
        self.gaits[gait.key] = gait
        return True

    def offer_front(self, gait: Gait) -> bool:
        """Keeps a gait of the nominal plant in the front unless one there beats it; returns whether it was kept."""
        if gait.mean_speed <= 0.0 or any(g.dominates(gait) for g in self.front):
            return False
        others = [g for g in self.front if not gait.dominates(g)]
        self.front = sorted([*others, gait], key=lambda g: g.mean_speed)
        return True

    def save(self, folder: Path = FOLDER) -> None:
        """Writes the archive."""
        oracle = {**vars(self.oracle), "gaits": [gait.key for gait in self.oracle.gaits]}
        gaits = [asdict(self.gaits[key]) for key in sorted(self.gaits)]
        front = [asdict(gait) for gait in self.front]
        write_archive(folder, {"iterations": self.iterations, "oracle": oracle, "gaits": gaits, "front": front})


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
        oracle = GaitMap(**{**content["oracle"], "gaits": used})
        archive = Archive(gaits, [Gait(**fields) for fields in content["front"]], oracle, content["iterations"])
        for gait in archive.everything():
            if len(gait.parameters) != len(FAMILIES[gait.family].units):
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
