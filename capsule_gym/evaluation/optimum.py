"""The speed of dynamic programming on a plant, of which `share_of_optimum` is the share.

`python -m baselines.dynamic_programming` computes the archive in `FOLDER`; this module reads its
speeds.
"""

import json
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path

import numpy as np

from capsule_gym.core.elementary import log
from capsule_gym.parameters import NOMINAL, Capsule
from capsule_gym.tasks.task import CONTROL_DT

FOLDER = Path(__file__).parents[1] / "data" / "optimum"
# Files of the archive: an object whose list has one result a line, and the arrays.
ARCHIVE = "archive.json"
ARRAYS = "arrays.npz"


@dataclass(frozen=True)
class PlantGrid:
    """A grid of plants, between which solutions are interpolated linearly in M and log(mu).

    Attributes:
        M: masses of the platform, kg, in ascending order.
        mu: friction coefficients, in ascending order.
        static_ratio: static over kinetic friction coefficient of all plants.
    """

    M: tuple[float, ...]
    mu: tuple[float, ...]
    static_ratio: float = NOMINAL.static_ratio

    @property
    def capsule(self) -> Capsule:
        """The constants that the plants share."""
        return Capsule(static_ratio=self.static_ratio)

    @cached_property
    def log_mu(self) -> tuple[float, ...]:
        """The logarithms of mu."""
        return tuple(log(np.array(self.mu)).tolist())

    @property
    def plants(self) -> tuple[tuple[float, float], ...]:
        """M and mu of all plants."""
        return tuple((M, mu) for M in self.M for mu in self.mu)

    def __contains__(self, plant: tuple[float, float]) -> bool:
        """Whether a plant, M in kg and mu, lies within the grid."""
        M, mu = plant
        return self.M[0] <= M <= self.M[-1] and self.mu[0] <= mu <= self.mu[-1]

    def cell(self, M: float, mu: float) -> tuple[list[int], float, float]:
        """The cell that contains a plant, M in kg and mu, or the nearest one.

        Returns:
            The four corners of the cell as indices of `plants`, and the position in the cell along
            M and along log(mu), each from 0 to 1.
        """

        def along(value: float, nodes: Sequence[float]) -> tuple[int, float]:
            above = min(max(bisect_right(nodes, value), 1), len(nodes) - 1)
            cell = above - 1
            position = (value - nodes[cell]) / (nodes[above] - nodes[cell])
            return cell, min(max(position, 0.0), 1.0)

        row, along_M = along(M, self.M)
        log_mu = float(log(max(mu, self.mu[0])))
        column, along_mu = along(log_mu, self.log_mu)
        columns = len(self.mu)
        corners = [i * columns + j for i in (row, row + 1) for j in (column, column + 1)]
        return corners, along_M, along_mu


GRID = PlantGrid((0.35, 0.5, 0.75, 1.0), (0.005, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5))
# Grid of the frozen set `sticky`.
STICKY_GRID = PlantGrid((0.35, 0.5, 0.75), (0.2, 0.3, 0.45, 0.6), static_ratio=1.3)


def find_grid(capsule: Capsule) -> PlantGrid | None:
    """The grid whose plants have the constants of a capsule other than M and mu, or None."""
    return next((grid for grid in (GRID, STICKY_GRID) if grid.capsule == capsule), None)


@cache
def grid_speeds() -> dict[tuple[float, float, float], float]:
    """Mean speeds, cm/s, of the plants of all grids by M (kg), mu and static ratio."""
    results = json.loads((FOLDER / ARCHIVE).read_text(encoding="utf-8"))["results"]
    objective = {"energy_weight": 0.0, "control_dt": CONTROL_DT, "margin": 0.0}
    speeds = {}
    for result in results:
        if all(result[name] == value for name, value in objective.items()):
            speeds[result["M"], result["mu"], result["static_ratio"]] = result["mean_speed"]
    return speeds


@cache
def set_speeds() -> dict[tuple[float, float], float]:
    """Mean speeds, cm/s, of the plants of evaluation sets by M (kg) and mu."""
    with np.load(FOLDER / ARRAYS, allow_pickle=False) as arrays:
        return {(M, mu): speed for M, mu, speed in arrays["plants"].tolist()}


def interpolated_speed(M: float, mu: float, grid: PlantGrid = GRID) -> float:
    """The mean speed in cm/s, linear in M (kg) and log(mu) between the plants of a grid."""
    corners, along_M, along_mu = grid.cell(M, mu)
    plants = [grid.plants[corner] for corner in corners]
    speeds = grid_speeds()
    a, b, c, d = (speeds[M_node, mu_node, grid.static_ratio] for M_node, mu_node in plants)
    below = a + along_mu * (b - a)
    above = c + along_mu * (d - c)
    return below + along_M * (above - below)


@lru_cache(maxsize=4096)
def optimal_speed(M: float, mu: float, grid: PlantGrid = GRID) -> float:
    """The mean speed of dynamic programming on a plant, in cm/s; M in kg.

    The episode starts from rest and takes 33 s, with a torque within 1.5 N m every 20 ms.

    It is the speed of a computed trajectory, not an upper bound. The plants of the grid and of the
    sets `paper` and `wide` were solved themselves; for others the speed is interpolated between the
    plants of the grid, with errors of up to 3.3 %.

    Raises:
        ValueError: if the plant lies outside the grid, which must have its ratio of static to
            kinetic friction.
    """
    if (M, mu) not in grid:
        masses = f"M must be in [{grid.M[0]}, {grid.M[-1]}] kg"
        ranges = f"{masses} and mu in [{grid.mu[0]}, {grid.mu[-1]}]"
        raise ValueError(f"{ranges}, got M={M!r}, mu={mu!r}")
    solved = set_speeds().get((M, mu)) if grid is GRID else None
    return interpolated_speed(M, mu, grid) if solved is None else solved
