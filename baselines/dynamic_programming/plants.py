"""The plants of evaluation sets, each solved on the coarsest grid from the stored values of the plants around it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from baselines.archive import GRID
from baselines.dynamic_programming.archive import Archive
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.problem import Problem, Trajectory, plant_problems
from baselines.dynamic_programming.solver import GRIDS, STARTS, divide_nodes, final_solutions, run_policy, solve
from capsule_gym.evaluation_sets import load_set

SETS = ("paper", "wide")
# Plants that are solved between two writes of the archive.
PART = 20


def set_plants(*names: str) -> list[tuple[float, float]]:
    """M in kg and mu of all plants of sets, by default `SETS`, without repetitions."""
    return list(dict.fromkeys((plant.M, plant.mu) for name in names or SETS for plant in load_set(name).plants))


def solve_plant(problem: Problem, archive: Archive, shape: tuple[int, int, int] = GRIDS[0]) -> Trajectory:
    """The trajectory of a plant within `GRID`, solved over the ranges and from the values of the plants around it.

    The nodes of `shape` along s and w are divided between both by their ranges.
    """
    corners, along_M, along_mu = GRID.cell(problem.M, problem.mu)
    near = [archive.solution(plant_problems(GRID)[corner]) for corner in corners]
    weights = np.outer([1.0 - along_M, along_M], [1.0 - along_mu, along_mu]).ravel()
    y, w = (
        (min(low for low, _ in each), max(high for _, high in each))
        for each in ([s.grid.y for s in near], [s.grid.w for s in near])
    )
    curvature = sum(weight * solution.curvature for weight, solution in zip(weights.tolist(), near, strict=True))
    grid = Grid(divide_nodes(shape, y, w), y, w, problem.M)
    solution = solve(problem, grid, curvature=curvature, start=near[int(weights.argmax())])
    return run_policy(solution, STARTS[:1], final=final_solutions(solution))


def solve_plants(archive: Archive, missing: Sequence[tuple[float, float]]) -> Iterator[None]:
    """Iterates over plants, M in kg and mu, solves them and adds them to an archive with the values of `GRID`."""
    for n, (M, mu) in enumerate(missing):
        archive.add_plant(M, mu, solve_plant(Problem(M=M, mu=mu), archive))
        if n % PART == PART - 1 or n == len(missing) - 1:
            print(f"{n + 1}/{len(missing)} plants of the sets", flush=True)
            yield
