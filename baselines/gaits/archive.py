"""Best-known gaits of the direct-torque task.

For every plant of a grid in M and mu, and every family of `baselines.gaits.families`, `data/gaits.json` holds the
fastest gait that `python -m baselines.gaits` has found: torque limit 1.5 N m, |theta| < pi/2, N > 0, from rest over
33 s, with an agent step of 10 ms. A gait counts only if it is robust: with M, mu and the first angle moved by 1 part in
1000 its speed must move by less than 1 %. A gait that beats an entry replaces it; nothing else does.

The fastest gaits run close to the limits, and fail on plants a few percent off. The file therefore also holds tolerant
gaits, the best in the worst case with M 10 % and mu about 20 % off. `gait-nominal` is the tolerant gait of the nominal
plant; `gait-oracle` looks up, in the map of `data/oracle.json`, which of all gaits serves best around the plant
that it is shown.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from baselines.gaits import FOLDER
from baselines.gaits.families import FAMILIES
from capsule_gym.elementary import log
from capsule_gym.parameters import Capsule

GRID_M = (0.35, 0.5, 0.75, 1.0)
GRID_MU = (0.005, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5)
PLANTS = tuple((M, mu) for M in GRID_M for mu in GRID_MU)
# Points of the front closer than this in speed (cm/s) would only lengthen the file.
FRONT_SPACING = 0.5


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

    @property
    def tolerance(self) -> float:
        """What tolerant gaits are ordered by: `worst_speed` in cm/s, minus infinity where it was not looked at."""
        return -math.inf if self.worst_speed is None else self.worst_speed

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
        if gait.tolerance <= max([0.0, *(g.tolerance for g in same)]):
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


def _dominates(one: Gait, other: Gait) -> bool:
    """Whether one gait is no slower and no dearer than another."""
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


def between_plants(table: Mapping[tuple[float, float], float], M: float, mu: float) -> float:
    """What a table of the grid's plants says of a plant between them: linear in M and in log(mu).

    Args:
        table: a number for every plant of the grid.
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
    (row, share_M), (column, share_mu) = place(M, GRID_M), place(log(mu), log_grid())
    corners = [[table[GRID_M[i], GRID_MU[j]] for j in (column, column + 1)] for i in (row, row + 1)]
    below, above = (left + share_mu * (right - left) for left, right in corners)
    return below + share_M * (above - below)


def best_known_speed(M: float, mu: float) -> float:
    """The best-known gaits' mean speed from rest over 33 s at a torque limit of 1.5 N m, in cm/s; see `between_plants`.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.

    Raises:
        ValueError: if the plant lies outside the grid.
    """
    return between_plants({plant: gait.mean_speed for plant, gait in known_gaits().table().items()}, M, mu)


@lru_cache(maxsize=1)
def log_grid() -> list[float]:
    """The logarithms of `GRID_MU`."""
    return [log(mu) for mu in GRID_MU]


def place(value: float, grid: Sequence[float]) -> tuple[int, float]:
    """The cell of an ascending grid that a value lies in, and how far into it, from 0 to 1."""
    cell = min(bisect_right(grid, value), len(grid) - 1) - 1
    return cell, (value - grid[cell]) / (grid[cell + 1] - grid[cell])


def in_grid(M: float, mu: float) -> bool:
    """Whether a plant lies within the grid of known gaits."""
    return GRID_M[0] <= M <= GRID_M[-1] and GRID_MU[0] <= mu <= GRID_MU[-1]


def pareto_front() -> list[Gait]:
    """The gaits of the nominal plant that none beats in both speed and cost of transport, the slowest first."""
    archive, nominal = known_gaits(), Capsule()
    everything = [*archive.front, *archive.of_plant(nominal.M, nominal.mu)]
    kept = [g for g in everything if not any(_dominates(other, g) for other in everything if other != g)]
    return sorted(dict.fromkeys(kept), key=lambda g: g.mean_speed)
