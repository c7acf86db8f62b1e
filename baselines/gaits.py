"""Best-known gaits: the yardstick of the direct-torque task.

For every plant of a grid in M and mu, and every family of `gait_families`, `gait_data/gaits.json` holds the fastest
gait that `python -m baselines.gait_search` has found: torque limit 1.5 N m, |theta| < pi/2, N > 0, from rest over 33 s,
with an agent step of 10 ms. A gait counts only if it is robust: with M, mu and the first angle moved by 1 part in 1000
its speed must move by less than 1 %. A gait that beats an entry replaces it; nothing else does.

The fastest gaits run close to the limits, and fail on plants a few percent off. The file therefore also holds tolerant
gaits, the best in the worst case with M 10 % and mu about 20 % off. `gait-nominal` is the tolerant gait of the nominal
plant; `gait-oracle` looks up, in the map of `gait_data/oracle.json`, which of all gaits serves best around the plant
that it is shown.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from baselines.gait_families import FAMILIES, GAIT_DT, actions
from capsule_gym.parameters import Capsule

Act = Callable[[np.ndarray], np.ndarray]

FOLDER = Path(__file__).with_name("gait_data")
GRID_M = (0.35, 0.5, 0.75, 1.0)
GRID_MU = (0.005, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5)
PLANTS = tuple((M, mu) for M in GRID_M for mu in GRID_MU)
# Points of the front closer than this in speed (cm/s) would only lengthen the file.
FRONT_SPACING = 0.5
ENV_KWARGS: dict[str, Any] = {"control_dt": GAIT_DT}


@dataclass(frozen=True, kw_only=True)
class Gait:
    """A gait with what it achieves and where it came from.

    Attributes:
        M: mass of its plant's platform, kg.
        mu: friction coefficient of its plant.
        family: a name of `FAMILIES`.
        parameters: as the family names them.
        mean_speed: cm/s.
        cost_of_transport: integral |u theta_dot| dt / ((M + m) g distance).
        sensitivity: largest relative change of the mean speed for changes of 1 part in 1000.
        seed: of the search, and the number of the round.
        evaluations: candidates that the whole search had tried by the end of that round.
        seconds: for which the whole search had run by then.
        command: that ran the round.
        worst_speed: of a tolerant gait, the slowest mean speed with M 10 % and mu about 20 % off, cm/s; else None.
    """

    M: float
    mu: float
    family: str
    parameters: tuple[float, ...]
    mean_speed: float
    cost_of_transport: float
    sensitivity: float
    seed: tuple[int, int]
    evaluations: int
    seconds: float
    command: str
    worst_speed: float | None = None

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> Gait:
        """The gait from its JSON object."""
        return cls(**{**fields, "parameters": tuple(fields["parameters"]), "seed": tuple(fields["seed"])})


@dataclass
class Archive:
    """What a search knows.

    Attributes:
        plants: the grid as pairs of M (kg) and mu.
        gaits: the fastest of each plant and family, sorted by family, M and mu.
        front: gaits of the nominal plant, none slower and dearer than another, slowest first.
        tolerant: of each plant and family the gait with the largest `worst_speed`, sorted likewise.
        rounds: of the search so far.
        evaluations: candidates tried so far.
        seconds: that the search has run so far.
    """

    plants: tuple[tuple[float, float], ...] = PLANTS
    gaits: list[Gait] = field(default_factory=list)
    front: list[Gait] = field(default_factory=list)
    tolerant: list[Gait] = field(default_factory=list)
    rounds: int = 0
    evaluations: int = 0
    seconds: float = 0.0

    def of_plant(self, M: float, mu: float) -> list[Gait]:
        """The gaits of one plant, the fastest first."""
        return sorted((g for g in self.gaits if (g.M, g.mu) == (M, mu)), key=lambda g: -g.mean_speed)

    def table(self) -> dict[tuple[float, float], Gait]:
        """The fastest gait of every plant that has one."""
        return {plant: found[0] for plant in self.plants if (found := self.of_plant(*plant))}

    def offer(self, gait: Gait) -> bool:
        """Takes a gait where it is faster than the one known of its plant and family; returns whether it was."""
        same = [g for g in self.gaits if (g.M, g.mu, g.family) == (gait.M, gait.mu, gait.family)]
        if gait.mean_speed <= max([0.0, *(g.mean_speed for g in same)]):
            return False
        others = [g for g in self.gaits if g not in same]
        self.gaits = sorted([*others, gait], key=lambda g: (g.family, g.M, g.mu))
        return True

    def offer_tolerant(self, gait: Gait) -> bool:
        """Takes a gait where its worst speed beats that of the tolerant one known; returns whether it did."""
        same = [g for g in self.tolerant if (g.M, g.mu, g.family) == (gait.M, gait.mu, gait.family)]
        if _worst(gait) <= max([0.0, *(_worst(g) for g in same)]):
            return False
        others = [g for g in self.tolerant if g not in same]
        self.tolerant = sorted([*others, gait], key=lambda g: (g.family, g.M, g.mu))
        return True

    def everything(self) -> list[Gait]:
        """All gaits, of every list."""
        return [*self.gaits, *self.front, *self.tolerant]

    def library(self) -> list[Gait]:
        """The gaits that a policy may choose from: the fastest and the tolerant ones."""
        return [*self.gaits, *self.tolerant]

    def offer_front(self, gait: Gait) -> bool:
        """Takes a gait of the nominal plant into the front if none there beats it; returns whether it did."""
        if gait.mean_speed <= 0.0 or any(_dominates(g, gait) for g in self.front):
            return False
        front = [g for g in self.front if not _dominates(gait, g)]
        cell = math.floor(gait.mean_speed / FRONT_SPACING)
        crowd = [g for g in front if math.floor(g.mean_speed / FRONT_SPACING) == cell]
        if any(g.cost_of_transport < gait.cost_of_transport for g in crowd):
            return False
        self.front = sorted([*(g for g in front if g not in crowd), gait], key=lambda g: g.mean_speed)
        return True

    def to_json(self) -> str:
        """The text of the file: one gait a line."""

        def lines(gaits: Sequence[Gait]) -> str:
            return ",\n".join("  " + json.dumps(asdict(gait)) for gait in gaits)

        counts = {"rounds": self.rounds, "evaluations": self.evaluations, "seconds": round(self.seconds, 1)}
        return (
            f'{{\n "search": {json.dumps(counts)},\n "gaits": [\n{lines(self.gaits)}\n ],\n'
            f' "front": [\n{lines(self.front)}\n ],\n "tolerant": [\n{lines(self.tolerant)}\n ]\n}}\n'
        )


def _worst(gait: Gait) -> float:
    return -math.inf if gait.worst_speed is None else gait.worst_speed


def _dominates(one: Gait, other: Gait) -> bool:
    return one.mean_speed >= other.mean_speed and one.cost_of_transport <= other.cost_of_transport


def load_archive(folder: Path = FOLDER) -> Archive:
    """What is known; nothing where the folder holds no gaits.json.

    Args:
        folder: of gaits.json.

    Raises:
        ValueError: if the file is malformed.
    """
    path = folder / "gaits.json"
    if not path.is_file():
        return Archive()
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        names = ("gaits", "front", "tolerant")
        lists: dict[str, Any] = {name: [Gait.from_dict(each) for each in content[name]] for name in names}
        archive = Archive(**lists, **content["search"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} must be what the gait search writes, got {type(error).__name__}: {error}") from error
    for gait in archive.everything():
        if gait.family not in FAMILIES or len(gait.parameters) != len(FAMILIES[gait.family].names):
            raise ValueError(
                f"{path} must hold families {', '.join(FAMILIES)} with their numbers of parameters, got "
                f"{gait.family!r} with {len(gait.parameters)}"
            )
    return archive


@lru_cache(maxsize=1)
def known_gaits() -> Archive:
    """The committed gaits, read once.

    Raises:
        ValueError: if the data lacks a plant of the grid.
    """
    archive = load_archive()
    missing = [plant for plant in PLANTS if plant not in archive.table()]
    if missing:
        raise ValueError(f"{FOLDER / 'gaits.json'} must hold a gait for every plant of the grid, lacks {missing}")
    return archive


def best_known_speed(M: float, mu: float) -> float:
    """The best-known mean speed from rest over 33 s at a torque limit of 1.5 N m, in cm/s.

    Linear in M and in log(mu) between the plants of the grid: what is known between them without a search there.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.

    Raises:
        ValueError: if the plant lies outside the grid.
    """
    if not in_grid(M, mu):
        raise ValueError(
            f"M must be in [{GRID_M[0]}, {GRID_M[-1]}] kg and mu in [{GRID_MU[0]}, {GRID_MU[-1]}], "
            f"got M={M!r}, mu={mu!r}"
        )
    table = known_gaits().table()
    along_mu = [
        np.interp(math.log(mu), np.log(GRID_MU), [table[row, column].mean_speed for column in GRID_MU])
        for row in GRID_M
    ]
    return float(np.interp(M, GRID_M, along_mu))


def in_grid(M: float, mu: float) -> bool:
    """Whether a plant lies within the grid of known gaits."""
    return GRID_M[0] <= M <= GRID_M[-1] and GRID_MU[0] <= mu <= GRID_MU[-1]


def pareto_front() -> list[Gait]:
    """The gaits of the nominal plant that none beats in both speed and cost of transport, the slowest first."""
    archive, nominal = known_gaits(), Capsule()
    everything = [*archive.front, *archive.of_plant(nominal.M, nominal.mu)]
    kept = [g for g in everything if not any(_dominates(other, g) for other in everything if other != g)]
    return sorted(dict.fromkeys(kept), key=lambda g: g.mean_speed)


class Performance:
    """Gaits being performed: one per environment, changeable on the way, all on one clock.

    Args:
        gaits: one per environment.
    """

    def __init__(self, gaits: Sequence[Gait]) -> None:
        self.step = 0
        self.gaits = list(gaits)
        self._arrange()

    def change(self, gaits: Sequence[Gait]) -> None:
        """Goes on with other gaits, at the same time of the clock."""
        if list(gaits) != self.gaits:
            self.gaits = list(gaits)
            self._arrange()

    def _arrange(self) -> None:
        """Groups the environments by family, so that each is computed at once."""
        self._groups = []
        for name, family in FAMILIES.items():
            rows = np.array([i for i, gait in enumerate(self.gaits) if gait.family == name], np.int64)
            if rows.size:
                columns = np.array([self.gaits[i].parameters for i in rows]).T.copy()
                self._groups.append((family, rows, columns))

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The actions of this step, shape (n, 1), float32; counts the step."""
        out = np.zeros((len(self.gaits), 1), np.float32)
        for family, rows, columns in self._groups:
            out[rows] = actions(family, columns, self.step * GAIT_DT, observations[rows])
        self.step += 1
        return out


def start_nominal(seeds: Sequence[int]) -> Act:
    """The tolerant gait of the nominal plant, on every plant; the fastest one fails where M is 5 % off."""
    nominal = Capsule()
    gait = max((g for g in known_gaits().tolerant if (g.M, g.mu) == (nominal.M, nominal.mu)), key=_worst)
    return Performance([gait] * len(seeds)).act


@dataclass(frozen=True)
class Choice:
    """Which known gait to perform on which plant.

    Gaits of neighbouring plants can be different motions, and a mean of their parameters none at all; so the oracle
    does not interpolate but looks up the gait that proved fastest around the plant.

    Attributes:
        M: masses of the map's cells, kg, ascending.
        mu: friction coefficients of the map's cells, ascending.
        gaits: the gait of each cell, shape (len(M), len(mu)).
    """

    M: tuple[float, ...]
    mu: tuple[float, ...]
    gaits: tuple[tuple[Gait, ...], ...]

    def find(self, M: np.ndarray, mu: np.ndarray) -> list[Gait]:
        """The gaits of some plants: that of the nearest cell in M and log(mu), outside the map of its edge."""
        centres = np.array(self.M)
        rows = np.abs(M[:, None] - centres).argmin(axis=1)
        columns = np.abs(np.log(np.maximum(mu, self.mu[0]))[:, None] - np.log(self.mu)).argmin(axis=1)
        return [self.gaits[i][j] for i, j in zip(rows, columns, strict=True)]

    def to_json(self) -> str:
        """The text of the file: gaits are named by family, plant and whether they are tolerant."""
        used = list(dict.fromkeys(gait for row in self.gaits for gait in row))
        content = {
            "M": self.M,
            "mu": self.mu,
            "gaits": [[gait.family, gait.M, gait.mu, gait.worst_speed is not None] for gait in used],
            "choice": [[used.index(gait) for gait in row] for row in self.gaits],
        }
        return json.dumps(content) + "\n"


@lru_cache(maxsize=1)
def known_choice() -> Choice:
    """The committed map of the oracle, read once.

    Raises:
        ValueError: if the map is malformed or names a gait that does not exist.
    """
    path = FOLDER / "oracle.json"
    gaits = {(gait.family, gait.M, gait.mu, gait.worst_speed is not None): gait for gait in known_gaits().library()}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        used = [gaits[family, M, mu, tolerant] for family, M, mu, tolerant in content["gaits"]]
        rows = tuple(tuple(used[index] for index in row) for row in content["choice"])
        return Choice(tuple(content["M"]), tuple(content["mu"]), rows)
    except (KeyError, TypeError, ValueError, IndexError, FileNotFoundError) as error:
        raise ValueError(
            f"{path} must be what `python -m baselines.gait_search --oracle` writes, "
            f"got {type(error).__name__}: {error}"
        ) from error


def start_oracle(seeds: Sequence[int]) -> Act:
    """For every plant the gait that proved fastest around it; M and mu are the last two observations."""
    choice = known_choice()
    seen = np.zeros((len(seeds), 2), np.float32)
    performance = Performance([choice.gaits[0][0]] * len(seeds))

    def act(observations: np.ndarray) -> np.ndarray:
        plants = observations[:, -2:]
        # On most steps no plant has changed, and the search for its gait is spared.
        if not np.array_equal(plants, seen):
            seen[:] = plants
            performance.change(choice.find(plants[:, 0].astype(np.float64), plants[:, 1].astype(np.float64)))
        return performance.act(observations)

    return act
