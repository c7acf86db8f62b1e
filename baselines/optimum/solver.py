"""The solver: policy iteration for the mean reward per hold, on a grid of states.

The optimal gain g (cm a hold) and the relative value h (cm) solve

    h(state) = max over torques of  reward + h(state after the hold) - g,

where every state is taken from the grid's nodes, moved by the environment's own step and interpolated. Interpolation
makes it a Markov chain with finitely many states; its weights are not negative, so that the operator is monotone. A
state after which nothing comes (the pendulum at 90 degrees, no contact, off the grid) is worth `DEATH`.

The slow coordinate w bends all values alike, and linear interpolation would take the bend for a gain: the parabola of
curvature `bend` is exempt from it, which is the same as a reward of its own for every hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np

from baselines.optimum.grid import DEAD, Grid, interpolate
from baselines.optimum.holds import Holds, hold_options
from capsule_gym.compilation import compile_cached
from capsule_gym.parameters import NOMINAL, Capsule, EnvConfig, check_number
from capsule_gym.task import CONTROL_DT, START_THETA, TORQUE_LIMIT

# cm: more than the optimum covers in two seconds.
DEATH = -50.0
TORQUES = 9
# How often torques around a node's best are added, and where these lie, in spacings of the last ones.
REFINEMENTS = 2
LOCAL = np.linspace(-1.0, 1.0, 9)
# States that one call of the environment's step moves.
BATCH = 8192
# s: what the sweeps between two choices of torques look ahead.
SWEPT = 0.8
MOST_ROUNDS = 60
# Converged where no value drifts by more than this from the others, cm a second.
TOLERANCE = 0.02


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is to be optimised.

    Attributes:
        M: mass of the platform, kg.
        mu: friction coefficient.
        energy_weight: cost of a joule, cm.
        hold: how long a torque is held, s.
        torque_limit: N m.
        margin: normal force that must be left, N; where less is, the motion counts as dead.
        capsule: the plant's other constants.

    Raises:
        TypeError: if a value is of the wrong type.
        ValueError: if a value is out of range.
    """

    M: float = NOMINAL.M
    mu: float = NOMINAL.mu
    energy_weight: float = 0.0
    hold: float = CONTROL_DT
    torque_limit: float = TORQUE_LIMIT
    margin: float = 0.0
    capsule: Capsule = field(default=NOMINAL)

    def __post_init__(self) -> None:
        self.capsule.check_plant(self.M, self.mu)
        check_number("hold", self.hold, "a finite number > 0 (s)", 0.0, open_low=True)
        check_number("margin", self.margin, "a finite number >= 0 (N)", 0.0)
        _ = self.options

    @cached_property
    def options(self) -> EnvConfig:
        """The environment in which a step is a hold."""
        return hold_options(self.hold, self.torque_limit, self.energy_weight, self.capsule)

    def holds(self, count: int) -> Holds:
        """So many states of this plant."""
        holds = Holds(count, self.options)
        holds.set_plants(np.full(count, self.M), np.full(count, self.mu))
        return holds


@dataclass(frozen=True)
class Solution:
    """The optimum on a grid.

    Attributes:
        problem: what was optimised.
        grid: on which.
        values: h at the nodes, cm, shape of the grid, float32; 0 at the start of an episode.
        curvature: of all values along w, over 2, in cm / (rad/s)^2.
        gain: mean reward of the Markov chain, cm/s.
        drift: how far the fastest and the slowest drift of a live value lie apart, cm/s; 0 were it solved exactly.
    """

    problem: Problem
    grid: Grid
    values: np.ndarray
    curvature: float
    gain: float
    drift: float

    @property
    def bend(self) -> float:
        """The curvature times the square of the spacing of w, cm."""
        return bend_of(self.curvature, self.grid)

    def at(self, states: np.ndarray) -> np.ndarray:
        """The values of states of shape (3, n), cm; `DEATH` off the grid."""
        return values_at(self.values, self.grid.positions(states), self.bend)


def bend_of(curvature: float, grid: Grid) -> float:
    """The curvature times the square of the spacing of w, cm."""
    spacing = float(grid.axes[2, 1])
    return curvature * spacing * spacing


def transitions(
    problem: Problem, grid: Grid, torques: np.ndarray, report: Callable[[str], None] = lambda line: None
) -> tuple[np.ndarray, np.ndarray]:
    """One hold from every node under every torque.

    Args:
        problem: with the plant.
        grid: of the nodes.
        torques: over the limit, shape (nodes, torques).
        report: is told how far it is.

    Returns:
        Positions on the grid, shape (nodes, torques, 3), and rewards in cm, (nodes, torques), both float32.
    """
    states = grid.nodes()
    nodes = states.shape[1]
    count = torques.shape[1]
    positions = np.empty((nodes, count, 3), np.float32)
    rewards = np.empty((nodes, count), np.float32)
    batch = min(BATCH, nodes)
    holds = problem.holds(batch)
    for first in range(0, nodes, batch):
        report(f"transitions {first / nodes:.0%}")
        # The last batch ends at the last node: some are moved twice.
        begin = min(first, nodes - batch)
        part = slice(begin, begin + batch)
        for n in range(count):
            holds.put(states[:, part])
            ends, rewards[part, n], dead = holds.take(torques[part, n])
            dead |= holds.normal_force() <= problem.margin
            positions[part, n] = np.where(dead[:, None], DEAD, grid.positions(ends))
    return positions, rewards


def _improve(
    values: np.ndarray,
    out: np.ndarray,
    chosen: np.ndarray,
    positions: np.ndarray,
    rewards: np.ndarray,
    gain: float,
    bend: float,
    death: float,
) -> None:
    """One sweep of value iteration from `values` to `out`, which are flat; `chosen` gets the torques."""
    for n in range(rewards.shape[0]):
        best = -np.inf
        for a in range(rewards.shape[1]):
            i, j, k = positions[n, a]
            after = death if i < 0.0 else interpolate(values, i, j, k, bend)
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
    bend: float,
    death: float,
    sweeps: int,
) -> None:
    """An even number of sweeps under the chosen torques; `values` holds the last."""
    for sweep in range(sweeps):
        source, target = (values, other) if sweep % 2 == 0 else (other, values)
        for n in range(rewards.shape[0]):
            a = chosen[n]
            i, j, k = positions[n, a]
            after = death if i < 0.0 else interpolate(source, i, j, k, bend)
            target.flat[n] = rewards[n, a] + after - gain


def _interpolate_all(values: np.ndarray, positions: np.ndarray, bend: float, death: float, out: np.ndarray) -> None:
    """Writes the values at positions of shape (n, 3)."""
    for n in range(out.size):
        i, j, k = positions[n]
        out[n] = death if i < 0.0 else interpolate(values, i, j, k, bend)


@cache
def _compiled(function: Callable[..., None]) -> Any:
    """One of the functions above, compiled."""
    return compile_cached(function)


def values_at(values: np.ndarray, positions: np.ndarray, bend: float) -> np.ndarray:
    """The values at positions, shape (n,); `DEATH` where there is none.

    Args:
        values: at the nodes, shape of the grid.
        positions: from `Grid.positions`, shape (n, 3).
        bend: see `Solution`.
    """
    out = np.empty(len(positions))
    _compiled(_interpolate_all)(values, positions, bend, DEATH, out)
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
    report: Callable[[str], None] = lambda line: None,
) -> Solution:
    """Solves a problem on a grid.

    Args:
        problem: what is to be optimised.
        grid: on which.
        torques: how many, evenly spaced over the limits; an odd number holds 0, and 1 is 0 alone.
        refinements: how often every node gets, beside these, torques closer around its best.
        curvature: see `Solution`.
        start: a solution on another grid, to begin with.
        tolerance: of the drift, cm/s.
        report: is told how far it is.
    """
    nodes = math.prod(grid.shape)
    coarse = np.linspace(-1.0, 1.0, torques) if torques > 1 else np.zeros(1)
    actions = np.tile(coarse, (nodes, 1))
    positions, rewards = transitions(problem, grid, actions, report)
    bend = bend_of(curvature, grid)
    values: np.ndarray = np.zeros(grid.shape, np.float32)
    if start is not None:
        values = start.at(grid.nodes()).astype(np.float32).reshape(grid.shape)
    origin = grid.positions(np.array([[START_THETA], [0.0], [0.0]]))
    gain, drift = (start.gain if start else 0.0) * problem.hold, np.inf
    other = np.empty_like(values)
    chosen = np.zeros(nodes, np.int32)
    spacing = 2.0 / max(torques - 1, 1)
    sweeps = 2 * round(0.5 * SWEPT / problem.hold)
    for refinement in range(refinements + 1):
        if refinement > 0 and torques > 1:
            best = np.take_along_axis(actions, chosen[:, None].astype(np.int64), axis=1)
            around = np.clip(best + spacing * LOCAL, -1.0, 1.0)
            spacing *= LOCAL[1] - LOCAL[0]
            more = transitions(problem, grid, around, report)
            actions = np.concatenate([actions[:, :torques], around], axis=1)
            positions = np.concatenate([positions[:, :torques], more[0]], axis=1)
            rewards = np.concatenate([rewards[:, :torques], more[1]], axis=1)
        for rounds in range(MOST_ROUNDS):
            _compiled(_improve)(values, other, chosen, positions, rewards, gain, bend, DEATH)
            values, other = other, values
            before = values.copy()
            _compiled(_evaluate)(values, other, chosen, positions, rewards, gain, bend, DEATH, sweeps)
            change = ((values - before) / sweeps)[before > 0.5 * DEATH]
            gain += float(np.median(change))
            values -= np.float32(values_at(values, origin, bend)[0])
            drift = float(np.ptp(change)) / problem.hold
            report(f"round {rounds + 1}: {gain / problem.hold:.3f} cm/s, drift {drift:.2g}")
            if drift < tolerance:
                break
    return Solution(problem, grid, values, curvature, gain / problem.hold, drift)
