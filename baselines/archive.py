"""The grids of plants of dynamic programming, what reading a malformed file raises, and the loops of searches."""

from __future__ import annotations

import math
import zipfile
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from capsule_gym.elementary import log
from capsule_gym.parameters import NOMINAL, Capsule


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
            The four corners of the cell as indices of `plants`, and the position in the cell along M and along log(mu),
            each from 0 to 1.
        """

        def along(value: float, nodes: Sequence[float]) -> tuple[int, float]:
            cell = min(max(bisect_right(nodes, value), 1), len(nodes) - 1) - 1
            return cell, min(max((value - nodes[cell]) / (nodes[cell + 1] - nodes[cell]), 0.0), 1.0)

        row, along_M = along(M, self.M)
        column, along_mu = along(float(log(max(mu, self.mu[0]))), self.log_mu)
        corners = [i * len(self.mu) + j for i in (row, row + 1) for j in (column, column + 1)]
        return corners, along_M, along_mu


GRID = PlantGrid((0.35, 0.5, 0.75, 1.0), (0.005, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5))
# Grid of the frozen set `sticky`.
STICKY_GRID = PlantGrid((0.35, 0.5, 0.75), (0.2, 0.3, 0.45, 0.6), static_ratio=1.3)
# What reading a malformed archive of numpy or JSON file raises.
UNREADABLE = (
    *(EOFError, IndexError, KeyError, MemoryError, OSError, RecursionError, TypeError, ValueError),
    *(zipfile.BadZipFile, zlib.error),
)


def find_grid(capsule: Capsule) -> PlantGrid | None:
    """The grid whose plants have the constants of a capsule other than M and mu, or None."""
    return next((grid for grid in (GRID, STICKY_GRID) if grid.capsule == capsule), None)


def make_strategy(start: np.ndarray, step: float, population: int, rng: np.random.Generator) -> Any:
    """A CMA-ES of the package `cma` that draws from `rng`; it would otherwise seed numpy's global generator."""
    draws = {"seed": math.nan, "randn": lambda *shape: rng.standard_normal(shape)}
    return import_module("cma").CMAEvolutionStrategy(start, step, {"popsize": population, "verbose": -9, **draws})


def run_search(steps: Iterable[object], save: Callable[[], None]) -> bool:
    """Iterates over the steps of a search and saves after each; Ctrl-C ends the search and keeps the saved results.

    Returns:
        Whether Ctrl-C ended the search.
    """
    try:
        for _ in steps:
            save()
    except KeyboardInterrupt:
        save()
        print("\ninterrupted: results so far are kept", flush=True)
        return True
    return False
