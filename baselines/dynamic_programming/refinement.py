"""Solving on grids from coarse to fine: the ranges of the grids, the values' curvature, the policies' trajectories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from baselines.dynamic_programming.grid import INITIAL_Y, MIN_COSINE, Grid
from baselines.dynamic_programming.problem import Problem
from baselines.dynamic_programming.solver import Solution, solve
from baselines.dynamic_programming.trajectory import SETTLED, Trajectory, run_policy
from capsule_gym.task import START_THETA

# Nodes along theta, s and w. The first grid is also that of the policies' values.
GRIDS = ((31, 51, 16), (46, 76, 24), (61, 101, 32), (91, 151, 48))
# Ratio of the nodes of s and w over that of the ranges of y and w, and its limits.
NODE_RATIO, MIN_RATIO, MAX_RATIO = 0.7, 0.25, 3.2
# Angles from which trajectories start: the task's own first, then others up to 0.1 rad from it.
STARTS = START_THETA + np.array([0.0, *np.linspace(-0.1, 0.1, 6)])
# The grid extends beyond the trajectories by this share of their range of y and w, and by at least so much, rad/s.
ROOM, MIN_ROOM = 0.3, 1.0


class GridResult(NamedTuple):
    """The result on one grid.

    Attributes:
        solution: on the grid.
        trajectory: its policy's episodes from `STARTS`.
    """

    solution: Solution
    trajectory: Trajectory


def ranges(trajectory: Trajectory, q: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ranges of y and w in rad/s that trajectories use, with room around them."""
    theta, theta_dot, _, x_dot = trajectory.states.transpose(1, 0, 2)
    cos = np.cos(theta)

    def with_room(values: np.ndarray) -> tuple[float, float]:
        low, high = float(values.min()), float(values.max())
        room = max(ROOM * (high - low), MIN_ROOM)
        return round(low - room, 2), round(high + room, 2)

    return with_room(x_dot / (q * np.maximum(cos, MIN_COSINE))), with_room(x_dot / q - cos * theta_dot)


def divide_nodes(shape: tuple[int, int, int], y: tuple[float, float], w: tuple[float, float]) -> tuple[int, int, int]:
    """Divides as many nodes between s and w by their ranges: where the platform mostly sticks, w is not slow.

    Args:
        shape: nodes along theta, s and w.
        y: range, rad/s.
        w: range, rad/s.
    """
    ratio = min(MAX_RATIO, max(MIN_RATIO, NODE_RATIO * (y[1] - y[0]) / (w[1] - w[0])))
    product = shape[1] * shape[2]
    along_s = round(math.sqrt(product * ratio))
    return shape[0], along_s, round(product / along_s)


def curvature_of(solution: Solution, trajectory: Trajectory) -> float:
    """Half the second derivative of the values along w, median over settled states, cm / (rad/s)^2."""
    first = round(SETTLED / solution.problem.control_dt)
    states = trajectory.states[first:, [0, 1, 3]].transpose(1, 0, 2).reshape(3, -1)
    positions = solution.grid.positions(states)
    i, j, k = (positions[positions[:, 0] >= 0.0] + 0.5).astype(np.int64).T
    k = np.clip(k, 1, solution.grid.shape[2] - 2)
    values = solution.values.astype(np.float64)
    second = values[i, j, k + 1] - 2.0 * values[i, j, k] + values[i, j, k - 1]
    return round(float(np.median(second)) / (2.0 * float(solution.grid.axes[2, 1]) ** 2), 3) if i.size else 0.0


def solve_on_grids(problem: Problem, shapes: Sequence[tuple[int, int, int]]) -> list[GridResult]:
    """Solves a problem on grids from coarse to fine.

    On the first grid it is solved twice: over ranges that contain any solution, and over those that its own
    trajectories use.

    Args:
        problem: what is optimised.
        shapes: nodes of the grids.

    Returns:
        One result per grid.
    """
    friction = min(problem.mu, 0.3)
    w = -3.0 - 25.0 * friction, 8.0 + 35.0 * friction
    grid = Grid(shapes[0], INITIAL_Y, w, problem.M)
    solution = solve(problem, grid)
    trajectory = run_policy(solution, STARTS)
    curvature = curvature_of(solution, trajectory)
    y, w = ranges(trajectory, grid.q)
    results = []
    for shape in shapes:
        finer = replace(grid, shape=divide_nodes(shape, y, w), y=y, w=w)
        solution = solve(problem, finer, curvature=curvature, start=solution)
        results.append(GridResult(solution, run_policy(solution, STARTS)))
    return results
