"""The solver: policy iteration for the mean reward per step, on grids of states from coarse to
fine.

The optimal gain g (cm per step) and the relative value h (cm) solve

    h(state) = max over torques of  reward + h(next state) - g,

where every state is a node of the grid, moved by the environment's own step and interpolated.
Interpolation makes it a Markov chain with finitely many states; its weights are not negative, so
that the operator is monotone. A failed next state (the pendulum at 90 degrees, no contact, off the
grid) has the value `FAILURE_VALUE`.

All values have a similar curvature along the slow coordinate w, and linear interpolation
overestimates a convex function. The parabola of that `curvature` is therefore excluded from the
interpolation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from baselines.dynamic_programming.grid import FAILED, INITIAL_Y, MIN_COSINE, Grid, interpolate
from baselines.dynamic_programming.problem import (
    ACTIONS,
    SETTLED,
    Problem,
    Trajectory,
    Transitions,
    run_episodes,
)
from capsule_gym.tasks.task import HORIZON, START_THETA

FAILURE_VALUE = -50.0  # cm: a loss larger than the distance of any policy in two seconds
TORQUES = 9  # at every node, evenly spaced within the limits
# Number of times that torques around the best are added at every node, and their offsets in
# previous spacings.
REFINEMENTS = 2
LOCAL = np.linspace(-1.0, 1.0, 9)
BATCH = 8192  # states per call of the environment's step
EVALUATION_TIME = 0.8  # s: duration of the policy evaluation between two improvements
ENDING = 0.8  # s: time before the end of an episode from which a policy considers the end; longer than a cycle
# The iteration has converged when the range of the changes of the values is smaller, cm/s.
MAX_ITERATIONS, TOLERANCE = 60, 0.02
# Nodes along theta, s and w. The first grid is also that of the policies' values.
GRIDS = ((31, 51, 16), (46, 76, 24), (61, 101, 32), (91, 151, 48))
# Ratio of the numbers of nodes of s and w over the ratio of the ranges of y and w; limits of the
# first ratio.
NODE_RATIO, MIN_RATIO, MAX_RATIO = 0.7, 0.25, 3.2
# Angles from which trajectories start: the task's own first, then others up to 0.1 rad from it.
STARTS = START_THETA + np.array([0.0, *np.linspace(-0.1, 0.1, 6)])
# The grid extends beyond the trajectories by this share of their range of y and w, and by at least
# MIN_ROOM, rad/s.
ROOM, MIN_ROOM = 0.3, 1.0


@dataclass(frozen=True)
class Solution:
    """The solution of a problem on a grid."""

    problem: Problem
    grid: Grid
    values: np.ndarray  # h at the nodes, cm, float32, 0 at the start of an episode
    curvature: float  # half the second derivative of the values along w, cm / (rad/s)^2
    gain: float  # cm/s

    def at(self, states: np.ndarray) -> np.ndarray:
        """The values of states of shape (3, n), cm; `FAILURE_VALUE` off the grid."""
        return next_values(
            self.values, self.grid.positions(states), cell_curvature(self.curvature, self.grid)
        )


def cell_curvature(curvature: float, grid: Grid) -> float:
    """The curvature times the square of the spacing of w, cm."""
    return curvature * float(grid.axes[2, 1]) * float(grid.axes[2, 1])


def transitions(problem: Problem, grid: Grid, torques: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions, shape (nodes, torques, 3), and rewards in cm, both float32, after a step with
    torques over limit.
    """
    states = grid.nodes()
    nodes, count = torques.shape
    positions = np.empty((nodes, count, 3), np.float32)
    rewards = np.empty((nodes, count), np.float32)
    batch = min(BATCH, nodes)
    model = Transitions(problem, batch)
    for first in range(0, nodes, batch):
        # The last batch ends at the last node, so some nodes are computed twice.
        begin = min(first, nodes - batch)
        part = slice(begin, begin + batch)
        for n in range(count):
            ends, rewards[part, n], failed = model.step(states[:, part], torques[part, n])
            positions[part, n] = np.where(failed[:, None], FAILED, grid.positions(ends))
    return positions, rewards


def next_values(values: np.ndarray, positions: np.ndarray, curvature: float) -> np.ndarray:
    """The values at positions of shape (nodes, 3), cm; `curvature` is `cell_curvature`."""
    # Positions of failed steps are indices from the array's end.
    found = interpolate(values.reshape(-1), tuple(positions.T), values.shape, curvature)
    return np.where(positions[:, 0] < 0.0, FAILURE_VALUE, found)


def _backup(
    values: np.ndarray, positions: np.ndarray, rewards: np.ndarray, gain: float, curvature: float
) -> tuple[np.ndarray, np.ndarray]:
    """One step of value iteration: the new values, cm, and the indices of the best torques, each of
    shape (nodes,).
    """
    new, chosen = np.full(len(rewards), -np.inf), np.zeros(len(rewards), np.int64)
    for torque in range(rewards.shape[1]):
        found = rewards[:, torque] + next_values(values, positions[:, torque], curvature)
        better = found > new
        new[better], chosen[better] = found[better], torque
    return new - gain, chosen


def solve(
    problem: Problem, grid: Grid, *, curvature: float = 0.0, start: Solution | None = None
) -> Solution:
    """Solves a problem on a grid, starting from the values of a solution on another grid if one is
    given.
    """
    cell = cell_curvature(curvature, grid)
    actions = np.tile(np.linspace(-1.0, 1.0, TORQUES), (math.prod(grid.shape), 1))
    positions, rewards = transitions(problem, grid, actions)
    values: np.ndarray = np.zeros(grid.shape, np.float32)
    if start is not None:
        values = start.at(grid.nodes()).astype(np.float32).reshape(grid.shape)
    origin = np.array([[START_THETA], [0.0], [0.0]])
    gain, spacing = (start.gain if start else 0.0) * problem.control_dt, 2.0 / (TORQUES - 1)
    steps, chosen = (
        2 * round(0.5 * EVALUATION_TIME / problem.control_dt),
        np.zeros(len(actions), np.int64),
    )
    for refinement in range(REFINEMENTS + 1):
        if refinement > 0:
            around = np.clip(
                np.take_along_axis(actions, chosen[:, None], axis=1) + spacing * LOCAL, -1.0, 1.0
            )
            spacing *= LOCAL[1] - LOCAL[0]
            more_positions, more_rewards = transitions(problem, grid, around)
            actions = np.concatenate([actions[:, :TORQUES], around], axis=1)
            positions = np.concatenate([positions[:, :TORQUES], more_positions], axis=1)
            rewards = np.concatenate([rewards[:, :TORQUES], more_rewards], axis=1)
        for _ in range(MAX_ITERATIONS):
            improved, chosen = _backup(values, positions, rewards, gain, cell)
            before = values = improved.astype(np.float32).reshape(grid.shape)
            own, own_rewards = (
                each[np.arange(len(chosen)), chosen] for each in (positions, rewards)
            )
            for _ in range(steps):
                evaluated = own_rewards + next_values(values, own, cell) - gain
                values = evaluated.astype(np.float32).reshape(grid.shape)
            change = ((values - before) / steps)[before > 0.5 * FAILURE_VALUE]
            gain += float(np.median(change))
            values = values - np.float32(
                Solution(problem, grid, values, curvature, gain).at(origin)[0]
            )
            if float(np.ptp(change)) / problem.control_dt < TOLERANCE:
                break
    return Solution(problem, grid, values, curvature, gain / problem.control_dt)


def final_solutions(solution: Solution) -> list[Solution]:
    """The values with 0, 1, .. steps to go, up to `ENDING`; rewards after the end of an episode do
    not count.
    """
    problem, grid = solution.problem, solution.grid
    actions = np.tile(np.linspace(-1.0, 1.0, TORQUES), (math.prod(grid.shape), 1))
    positions, rewards = transitions(problem, grid, actions)
    cell = cell_curvature(solution.curvature, grid)
    found = [replace(solution, values=np.zeros(grid.shape, np.float32))]
    for _ in range(round(ENDING / problem.control_dt) - 1):
        values, _ = _backup(found[-1].values, positions, rewards, 0.0, cell)
        found.append(replace(solution, values=values.astype(np.float32).reshape(grid.shape)))
    return found


def run_policy(
    solution: Solution,
    thetas: np.ndarray,
    *,
    final: Sequence[Solution] = (),
    horizon: float = HORIZON,
) -> Trajectory:
    """Runs the policy that looks one step ahead, from rest at the angles `thetas` in rad, for
    `horizon` s.

    `final` are the values before the end, from `final_solutions`; without them the policy ignores
    the end.
    """
    model = Transitions(solution.problem, thetas.size * ACTIONS.size)
    actions = np.tile(ACTIONS, thetas.size)
    steps = round(horizon / solution.problem.control_dt)

    def choose(step: int, states: np.ndarray) -> np.ndarray:
        ends, rewards, failed = model.step(
            np.repeat(states[[0, 1, 3]], ACTIONS.size, axis=1), actions
        )
        left = steps - 1 - step
        scores = np.where(
            failed, -np.inf, rewards + (final[left] if left < len(final) else solution).at(ends)
        )
        return scores.reshape(-1, ACTIONS.size).argmax(axis=1)

    return run_episodes(solution.problem, thetas, steps, choose)


def ranges(trajectory: Trajectory, q: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ranges of y and w in rad/s that trajectories cover, with a margin."""
    theta, theta_dot, _, x_dot = trajectory.states.transpose(1, 0, 2)
    cos = np.cos(theta)

    def with_room(values: np.ndarray) -> tuple[float, float]:
        low, high = float(values.min()), float(values.max())
        room = max(ROOM * (high - low), MIN_ROOM)
        return round(low - room, 2), round(high + room, 2)

    return with_room(x_dot / (q * np.maximum(cos, MIN_COSINE))), with_room(
        x_dot / q - cos * theta_dot
    )


def divide_nodes(
    shape: tuple[int, int, int], y: tuple[float, float], w: tuple[float, float]
) -> tuple[int, int, int]:
    """Divides the same number of nodes between s and w by their ranges: w is not slow if the
    platform mostly sticks.
    """
    ratio = min(MAX_RATIO, max(MIN_RATIO, NODE_RATIO * (y[1] - y[0]) / (w[1] - w[0])))
    product = shape[1] * shape[2]
    along_s = round(math.sqrt(product * ratio))
    return shape[0], along_s, round(product / along_s)


def curvature_of(solution: Solution, trajectory: Trajectory) -> float:
    """Half the second derivative of the values along w, median over settled states, cm /
    (rad/s)^2.
    """
    first = round(SETTLED / solution.problem.control_dt)
    states = trajectory.states[first:, [0, 1, 3]].transpose(1, 0, 2).reshape(3, -1)
    positions = solution.grid.positions(states)
    i, j, k = (positions[positions[:, 0] >= 0.0] + 0.5).astype(np.int64).T
    k = np.clip(k, 1, solution.grid.shape[2] - 2)
    values = solution.values.astype(np.float64)
    second = values[i, j, k + 1] - 2.0 * values[i, j, k] + values[i, j, k - 1]
    return (
        round(float(np.median(second)) / (2.0 * float(solution.grid.axes[2, 1]) ** 2), 3)
        if i.size
        else 0.0
    )


def solve_on_grids(
    problem: Problem, shapes: Sequence[tuple[int, int, int]]
) -> list[tuple[Solution, Trajectory]]:
    """The solutions on grids from coarse to fine, and their policies' episodes from `STARTS`."""
    friction = min(problem.mu, 0.3)
    # Contains any solution; the solutions that follow are over the ranges of its trajectories.
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
        results.append((solution, run_policy(solution, STARTS, final=final_solutions(solution))))
    return results
