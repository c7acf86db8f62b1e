"""The solver: policy iteration for the mean reward per step, on a grid of states.

The optimal gain g (cm per step) and the relative value h (cm) solve

    h(state) = max over torques of  reward + h(next state) - g,

where every state is a node of the grid, moved by the environment's own step and interpolated. Interpolation makes it a
Markov chain with finitely many states; its weights are not negative, so that the operator is monotone. A failed next
state (the pendulum at 90 degrees, no contact, off the grid) has the value `FAILURE_VALUE`.

All values have a similar curvature along the slow coordinate w, and linear interpolation overestimates a convex
function. The parabola of that `curvature` is therefore excluded from the interpolation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from baselines.dynamic_programming.grid import FAILED, Grid, interpolate
from baselines.dynamic_programming.problem import Problem, Transitions
from capsule_gym.compilation import compile_cached
from capsule_gym.task import START_THETA

# cm: a loss larger than the distance of any policy in two seconds.
FAILURE_VALUE = -50.0
TORQUES = 9
# How often torques around the best are added at every node, and their places in spacings of the previous ones.
REFINEMENTS = 2
LOCAL = np.linspace(-1.0, 1.0, 9)
# States that one call of the environment's step moves.
BATCH = 8192
# s: steps of policy evaluation between two improvements, as time.
EVALUATION_TIME = 0.8
MAX_ITERATIONS = 60
# cm/s: converged where the span of the values' changes is smaller.
TOLERANCE = 0.02


@dataclass(frozen=True)
class Solution:
    """The solution on a grid.

    Attributes:
        problem: what was optimised.
        grid: of the states.
        values: h at the nodes, cm, shape of the grid, float32; 0 at the start of an episode.
        curvature: half the second derivative of the values along w, in cm / (rad/s)^2.
        gain: mean reward of the Markov chain, cm/s.
        span: difference of the largest and the smallest change of a value in an iteration, cm/s; 0 if solved exactly.
    """

    problem: Problem
    grid: Grid
    values: np.ndarray
    curvature: float
    gain: float
    span: float

    def at(self, states: np.ndarray) -> np.ndarray:
        """The values of states of shape (3, n), cm; `FAILURE_VALUE` off the grid."""
        return values_at(self.values, self.grid.positions(states), cell_curvature(self.curvature, self.grid))


def cell_curvature(curvature: float, grid: Grid) -> float:
    """The curvature times the square of the spacing of w, cm."""
    spacing = float(grid.axes[2, 1])
    return curvature * spacing * spacing


def transitions(problem: Problem, grid: Grid, torques: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One step from every node under every torque.

    Args:
        problem: with the plant.
        grid: of the nodes.
        torques: over the limit, shape (nodes, torques).

    Returns:
        Positions on the grid, shape (nodes, torques, 3), and rewards in cm, (nodes, torques), both float32.
    """
    states = grid.nodes()
    nodes, count = torques.shape
    positions = np.empty((nodes, count, 3), np.float32)
    rewards = np.empty((nodes, count), np.float32)
    batch = min(BATCH, nodes)
    model = Transitions(problem, batch)
    for first in range(0, nodes, batch):
        # The last batch ends at the last node: some are moved twice.
        begin = min(first, nodes - batch)
        part = slice(begin, begin + batch)
        for n in range(count):
            ends, rewards[part, n], failed = model.step(states[:, part], torques[part, n])
            positions[part, n] = np.where(failed[:, None], FAILED, grid.positions(ends))
    return positions, rewards


def _improve(
    values: np.ndarray,
    out: np.ndarray,
    chosen: np.ndarray,
    positions: np.ndarray,
    rewards: np.ndarray,
    gain: float,
    curvature: float,
    failure: float,
) -> None:
    """One step of value iteration from `values` to `out`, which are flat; writes the best torques to `chosen`."""
    for n in range(rewards.shape[0]):
        best = -np.inf
        for a in range(rewards.shape[1]):
            i, j, k = positions[n, a]
            after = failure if i < 0.0 else interpolate(values, i, j, k, curvature)
            if rewards[n, a] + after > best:
                best = rewards[n, a] + after
                chosen[n] = a
        out.flat[n] = best - gain


def _evaluate(
    values: np.ndarray,
    other: np.ndarray,
    chosen: np.ndarray,
    positions: np.ndarray,
    rewards: np.ndarray,
    gain: float,
    curvature: float,
    failure: float,
    steps: int,
) -> None:
    """An even number of steps of policy evaluation under the chosen torques; `values` holds the last."""
    for step in range(steps):
        source, target = (values, other) if step % 2 == 0 else (other, values)
        for n in range(rewards.shape[0]):
            a = chosen[n]
            i, j, k = positions[n, a]
            after = failure if i < 0.0 else interpolate(source, i, j, k, curvature)
            target.flat[n] = rewards[n, a] + after - gain


def _interpolate_all(
    values: np.ndarray, positions: np.ndarray, curvature: float, failure: float, out: np.ndarray
) -> None:
    """Writes the values at positions of shape (n, 3)."""
    for n in range(out.size):
        i, j, k = positions[n]
        out[n] = failure if i < 0.0 else interpolate(values, i, j, k, curvature)


@cache
def _compiled(function: Callable[..., None]) -> Any:
    """One of the functions above, compiled."""
    return compile_cached(function)


def values_at(values: np.ndarray, positions: np.ndarray, curvature: float) -> np.ndarray:
    """The values at positions of shape (n, 3), from `Grid.positions`; `FAILURE_VALUE` off the grid."""
    out = np.empty(len(positions))
    _compiled(_interpolate_all)(values, positions, curvature, FAILURE_VALUE, out)
    return out


def solve(
    problem: Problem,
    grid: Grid,
    *,
    torques: int = TORQUES,
    refinements: int = REFINEMENTS,
    curvature: float = 0.0,
    start: Solution | None = None,
    tolerance: float = TOLERANCE,
) -> Solution:
    """Solves a problem on a grid.

    Args:
        problem: what is optimised.
        grid: of the states.
        torques: their number, evenly spaced within the limits; an odd number includes 0, and 1 is 0 alone.
        refinements: how often every node gets, in addition, torques closer around its best.
        curvature: see `Solution`.
        start: a solution on another grid, whose values are the initial ones.
        tolerance: of the span, cm/s.
    """
    nodes = math.prod(grid.shape)
    coarse = np.linspace(-1.0, 1.0, torques) if torques > 1 else np.zeros(1)
    actions = np.tile(coarse, (nodes, 1))
    positions, rewards = transitions(problem, grid, actions)
    cell = cell_curvature(curvature, grid)
    values: np.ndarray = np.zeros(grid.shape, np.float32)
    if start is not None:
        values = start.at(grid.nodes()).astype(np.float32).reshape(grid.shape)
    origin = grid.positions(np.array([[START_THETA], [0.0], [0.0]]))
    gain, span = (start.gain if start else 0.0) * problem.control_dt, np.inf
    other = np.empty_like(values)
    chosen = np.zeros(nodes, np.int32)
    spacing = 2.0 / max(torques - 1, 1)
    steps = 2 * round(0.5 * EVALUATION_TIME / problem.control_dt)
    for refinement in range(refinements + 1):
        if refinement > 0 and torques > 1:
            best = np.take_along_axis(actions, chosen[:, None].astype(np.int64), axis=1)
            around = np.clip(best + spacing * LOCAL, -1.0, 1.0)
            spacing *= LOCAL[1] - LOCAL[0]
            more_positions, more_rewards = transitions(problem, grid, around)
            actions = np.concatenate([actions[:, :torques], around], axis=1)
            positions = np.concatenate([positions[:, :torques], more_positions], axis=1)
            rewards = np.concatenate([rewards[:, :torques], more_rewards], axis=1)
        for _ in range(MAX_ITERATIONS):
            _compiled(_improve)(values, other, chosen, positions, rewards, gain, cell, FAILURE_VALUE)
            values, other = other, values
            before = values.copy()
            _compiled(_evaluate)(values, other, chosen, positions, rewards, gain, cell, FAILURE_VALUE, steps)
            change = ((values - before) / steps)[before > 0.5 * FAILURE_VALUE]
            gain += float(np.median(change))
            values -= np.float32(values_at(values, origin, cell)[0])
            span = float(np.ptp(change)) / problem.control_dt
            if span < tolerance:
                break
    return Solution(problem, grid, values, curvature, gain / problem.control_dt, span)
