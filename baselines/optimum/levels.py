"""From a coarse grid to a fine one: where the grid lies, how the values bend, and the motions that come out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from baselines.optimum.grid import LEAST_COSINE, WIDEST_Y, Grid
from baselines.optimum.motion import SETTLED, Motion, follow, steady_speed
from baselines.optimum.solver import Problem, Solution, solve
from capsule_gym.task import START_THETA

# Nodes along theta, s and w; the first is where the box is found, and what the policies are kept on.
LEVELS = ((31, 51, 16), (46, 76, 24), (61, 101, 32), (91, 151, 48))
PRODUCTION = LEVELS[:2]
# Nodes of s over those of w, as a multiple of the range of y over that of w, and its limits.
ALLOTMENT, LEAST_RATIO, LARGEST_RATIO = 0.7, 0.25, 3.2
# Half the width of the angles that motions start from, beside the task's own, rad, and their number.
SPREAD, STARTS = 0.1, 7
# The box reaches by this share of the range of y and w that motions use beyond it, and by at least so much, rad/s.
ROOM, LEAST_ROOM = 0.3, 1.0


@dataclass(frozen=True)
class Level:
    """What one grid gave.

    Attributes:
        solution: on the grid.
        motion: its policy's episodes from angles around the task's start, which is the first.
        steady: mean speed of the first over whole cycles, cm/s.
        seconds: that solving took.
    """

    solution: Solution
    motion: Motion
    steady: float
    seconds: float


def first_box(mu: float) -> tuple[float, float]:
    """A range of w in rad/s that holds the motions of any optimum on such a floor."""
    grip = min(mu, 0.3)
    return -3.0 - 25.0 * grip, 8.0 + 35.0 * grip


def box_of(motion: Motion, q: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ranges of y and w in rad/s that motions use, with room around them."""
    theta, theta_dot, _, x_dot = motion.states.transpose(1, 0, 2)
    cos = np.cos(theta)
    return _with_room(x_dot / (q * np.maximum(cos, LEAST_COSINE))), _with_room(x_dot / q - cos * theta_dot)


def _with_room(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = max(ROOM * (high - low), LEAST_ROOM)
    return round(low - room, 2), round(high + room, 2)


def allotted(shape: tuple[int, int, int], y: tuple[float, float], w: tuple[float, float]) -> tuple[int, int, int]:
    """As many nodes, shared between s and w by their ranges: where the platform mostly sticks, w is no slow coordinate.

    Args:
        shape: nodes along theta, s and w.
        y: range, rad/s.
        w: likewise.
    """
    ratio = ALLOTMENT * (y[1] - y[0]) / (w[1] - w[0])
    ratio = min(LARGEST_RATIO, max(LEAST_RATIO, ratio))
    product = shape[1] * shape[2]
    along_s = round(math.sqrt(product * ratio))
    return shape[0], along_s, round(product / along_s)


def curvature_of(solution: Solution, motion: Motion) -> float:
    """How the values bend along w, over 2, in the median over the states of settled motions, cm / (rad/s)^2."""
    first = round(SETTLED / solution.problem.hold)
    states = motion.states[first:, [0, 1, 3]].transpose(1, 0, 2).reshape(3, -1)
    positions = solution.grid.positions(states)
    i, j, k = (positions[positions[:, 0] >= 0.0] + 0.5).astype(np.int64).T
    k = np.clip(k, 1, solution.grid.shape[2] - 2)
    values = solution.values.astype(np.float64)
    second = values[i, j, k + 1] - 2.0 * values[i, j, k] + values[i, j, k - 1]
    return round(float(np.median(second)) / (2.0 * float(solution.grid.axes[2, 1]) ** 2), 3) if i.size else 0.0


def optimise(
    problem: Problem,
    levels: Sequence[tuple[int, int, int]] = PRODUCTION,
    report: Callable[[str], None] = lambda line: None,
) -> list[Level]:
    """Solves a problem on grids from coarse to fine.

    On the first grid it is solved twice: over a box that holds any optimum, and over the one that its own motions use.

    Args:
        problem: what is to be optimised.
        levels: nodes of the grids.
        report: is told how far it is.

    Returns:
        One per grid, in order.
    """
    starts = START_THETA + np.array([0.0, *np.linspace(-SPREAD, SPREAD, STARTS - 1)])
    grid = Grid(levels[0], WIDEST_Y, first_box(problem.mu), problem.M, problem.capsule)
    solution = solve(problem, grid, report=report)
    motion = follow(solution, starts)
    curvature = curvature_of(solution, motion)
    y, w = box_of(motion, grid.q)
    found: list[Level] = []
    for shape in levels:

        def tell(line: str, shape: tuple[int, int, int] = shape) -> None:
            report(f"{'x'.join(map(str, shape))} {line}")

        began = perf_counter()
        finer = replace(grid, shape=allotted(shape, y, w), y=y, w=w)
        solution = solve(problem, finer, curvature=curvature, start=solution, report=tell)
        seconds = perf_counter() - began
        motion = follow(solution, starts)
        found.append(Level(solution, motion, steady_speed(motion, problem.hold), seconds))
    return found
