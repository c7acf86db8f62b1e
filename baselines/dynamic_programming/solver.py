"""The solver: policy iteration for the mean reward per step, on grids from coarse to fine.

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
# s: time before the end of an episode from which a policy considers the end; longer than a cycle.
ENDING = 0.8
MAX_ITERATIONS = 60
# The iteration has converged when the range of the changes of the values is smaller, cm/s.
TOLERANCE = 0.02
# Nodes along theta, s and w. The first grid is also that of the policies' values.
GRIDS = ((31, 51, 16), (46, 76, 24), (61, 101, 32), (91, 151, 48))
# Ratio of the numbers of nodes of s and w over the ratio of the ranges of y and w; limits of the
# first ratio.
NODE_RATIO = 0.7
MIN_RATIO = 0.25
MAX_RATIO = 3.2
# Angles from which trajectories start: the task's own first, then others up to 0.1 rad from it.
STARTS = START_THETA + np.array([0.0, *np.linspace(-0.1, 0.1, 6)])
# The grid extends beyond the trajectories by this share of their range of y and w, and by at least
# MIN_ROOM, rad/s.
ROOM = 0.3
MIN_ROOM = 1.0


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
        cell = cell_curvature(self.curvature, self.grid)
        return next_values(self.values, self.grid.positions(states), cell)


def cell_curvature(curvature: float, grid: Grid) -> float:
    """The curvature times the square of the spacing of w, cm."""
    _, spacing = grid.axes[2].tolist()
    return curvature * spacing * spacing


def transitions(problem: Problem, grid: Grid, torques: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The next states and the rewards of a step from every node.

    Args:
        problem: the problem.
        grid: its grid.
        torques: shares of the torque limit, shape (nodes, torques).

    Returns:
        Grid coordinates of the next states, `FAILED` where the step fails, shape (nodes, torques,
        3), and rewards, cm, shape (nodes, torques); float32.
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
            reached = grid.positions(ends)
            positions[part, n] = np.where(failed[:, None], FAILED, reached)
    return positions, rewards


def next_values(values: np.ndarray, positions: np.ndarray, curvature: float) -> np.ndarray:
    """The values at positions of shape (nodes, 3), cm; `curvature` is `cell_curvature`."""
    # Positions of failed steps are indices from the array's end.
    found = interpolate(values.reshape(-1), tuple(positions.T), values.shape, curvature)
    return np.where(positions[:, 0] < 0.0, FAILURE_VALUE, found)


def _backup(
    values: np.ndarray, positions: np.ndarray, rewards: np.ndarray, gain: float, curvature: float
) -> tuple[np.ndarray, np.ndarray]:
    """One step of value iteration: the new values, cm, and the indices of the best torques.

    Both have the shape (nodes,).
    """
    best = np.full(len(rewards), -np.inf)
    chosen = np.zeros(len(rewards), np.int64)
    for torque in range(rewards.shape[1]):
        after = next_values(values, positions[:, torque], curvature)
        found = rewards[:, torque] + after
        better = found > best
        best[better] = found[better]
        chosen[better] = torque
    return best - gain, chosen


def _evenly_spaced(grid: Grid) -> np.ndarray:
    """`TORQUES` torques over limit at every node, shape (nodes, torques)."""
    torques = np.linspace(-1.0, 1.0, TORQUES)
    return np.tile(torques, (math.prod(grid.shape), 1))


def solve(
    problem: Problem, grid: Grid, *, curvature: float = 0.0, start: Solution | None = None
) -> Solution:
    """Solves a problem on a grid.

    The iteration starts from the values of a solution on another grid if one is given.
    """
    actions = _evenly_spaced(grid)
    positions, rewards = transitions(problem, grid, actions)
    values: np.ndarray = np.zeros(grid.shape, np.float32)
    gain = 0.0  # cm per step
    if start is not None:
        at_nodes = start.at(grid.nodes())
        values = at_nodes.astype(np.float32).reshape(grid.shape)
        gain = start.gain * problem.control_dt
    cell = cell_curvature(curvature, grid)
    origin = grid.positions(np.array([[START_THETA], [0.0], [0.0]]))
    steps = 2 * round(0.5 * EVALUATION_TIME / problem.control_dt)
    spacing = 2.0 / (TORQUES - 1)
    chosen = np.zeros(len(actions), np.int64)
    for refinement in range(REFINEMENTS + 1):
        if refinement > 0:
            best = np.take_along_axis(actions, chosen[:, None], axis=1)
            around = np.clip(best + spacing * LOCAL, -1.0, 1.0)
            spacing *= LOCAL[1] - LOCAL[0]
            more_positions, more_rewards = transitions(problem, grid, around)
            actions = np.concatenate([actions[:, :TORQUES], around], axis=1)
            positions = np.concatenate([positions[:, :TORQUES], more_positions], axis=1)
            rewards = np.concatenate([rewards[:, :TORQUES], more_rewards], axis=1)
        for _ in range(MAX_ITERATIONS):
            values, change, chosen = _improve(values, positions, rewards, gain, cell, steps)
            gain += float(np.median(change))
            values = values - np.float32(next_values(values, origin, cell)[0])
            if float(np.ptp(change)) / problem.control_dt < TOLERANCE:
                break
    return Solution(problem, grid, values, curvature, gain / problem.control_dt)


def _improve(
    values: np.ndarray,
    positions: np.ndarray,
    rewards: np.ndarray,
    gain: float,
    curvature: float,
    steps: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Improves the policy once, and evaluates it over a number of steps.

    Returns:
        The values of the nodes, cm; their changes per step where the policy does not fail; and the
        indices of the best torques.
    """
    improved, chosen = _backup(values, positions, rewards, gain, curvature)
    before = improved.astype(np.float32).reshape(values.shape)
    nodes = np.arange(len(chosen))
    own_positions = positions[nodes, chosen]
    own_rewards = rewards[nodes, chosen]
    after = before
    for _ in range(steps):
        evaluated = own_rewards + next_values(after, own_positions, curvature) - gain
        after = evaluated.astype(np.float32).reshape(values.shape)
    change = (after - before) / steps
    return after, change[before > 0.5 * FAILURE_VALUE], chosen


def final_solutions(solution: Solution) -> list[Solution]:
    """The values with 0, 1, .. steps to go, up to `ENDING`.

    Rewards after the end of an episode do not count.
    """
    problem = solution.problem
    grid = solution.grid
    positions, rewards = transitions(problem, grid, _evenly_spaced(grid))
    cell = cell_curvature(solution.curvature, grid)
    values: np.ndarray = np.zeros(grid.shape, np.float32)
    found = [replace(solution, values=values)]
    for _ in range(round(ENDING / problem.control_dt) - 1):
        improved, _ = _backup(values, positions, rewards, 0.0, cell)
        values = improved.astype(np.float32).reshape(grid.shape)
        found.append(replace(solution, values=values))
    return found


def run_policy(
    solution: Solution,
    thetas: np.ndarray,
    *,
    final: Sequence[Solution] = (),
    horizon: float = HORIZON,
) -> Trajectory:
    """Runs the policy that looks one step ahead, from rest at the angles `thetas` in rad.

    An episode lasts `horizon` s. `final` are the values before the end, from `final_solutions`;
    without them the policy ignores the end.
    """
    model = Transitions(solution.problem, thetas.size * ACTIONS.size)
    actions = np.tile(ACTIONS, thetas.size)
    steps = round(horizon / solution.problem.control_dt)

    def choose(step: int, states: np.ndarray) -> np.ndarray:
        repeated = np.repeat(states[[0, 1, 3]], ACTIONS.size, axis=1)
        ends, rewards, failed = model.step(repeated, actions)
        left = steps - 1 - step
        ahead = final[left] if left < len(final) else solution
        scores = np.where(failed, -np.inf, rewards + ahead.at(ends))
        return scores.reshape(-1, ACTIONS.size).argmax(axis=1)

    return run_episodes(solution.problem, thetas, steps, choose)


def ranges(trajectory: Trajectory, q: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ranges of y and w in rad/s that trajectories cover, with a margin."""
    theta, theta_dot, _, x_dot = trajectory.states.transpose(1, 0, 2)
    cos = np.cos(theta)
    y = x_dot / (q * np.maximum(cos, MIN_COSINE))
    w = x_dot / q - cos * theta_dot
    return _with_room(y), _with_room(w)


def _with_room(values: np.ndarray) -> tuple[float, float]:
    low = float(values.min())
    high = float(values.max())
    room = max(ROOM * (high - low), MIN_ROOM)
    return round(low - room, 2), round(high + room, 2)


def divide_nodes(
    shape: tuple[int, int, int], y: tuple[float, float], w: tuple[float, float]
) -> tuple[int, int, int]:
    """Divides the same number of nodes between s and w by their ranges.

    w is not slow if the platform mostly sticks.
    """
    low_y, high_y = y
    low_w, high_w = w
    ratio = NODE_RATIO * (high_y - low_y) / (high_w - low_w)
    ratio = min(MAX_RATIO, max(MIN_RATIO, ratio))
    along_theta, along_s, along_w = shape
    product = along_s * along_w
    along_s = round(math.sqrt(product * ratio))
    return along_theta, along_s, round(product / along_s)


def curvature_of(solution: Solution, trajectory: Trajectory) -> float:
    """Half the second derivative of the values along w, cm / (rad/s)^2.

    It is the median over settled states, or 0.0 if none is on the grid.
    """
    first = round(SETTLED / solution.problem.control_dt)
    settled = trajectory.states[first:, [0, 1, 3]]
    states = settled.transpose(1, 0, 2).reshape(3, -1)
    positions = solution.grid.positions(states)
    inside = positions[positions[:, 0] >= 0.0]
    if not inside.size:
        return 0.0
    i, j, k = (inside + 0.5).astype(np.int64).T
    k = np.clip(k, 1, solution.grid.shape[2] - 2)
    values = solution.values.astype(np.float64)
    before = values[i, j, k - 1]
    after = values[i, j, k + 1]
    second = after - 2.0 * values[i, j, k] + before
    _, spacing = solution.grid.axes[2].tolist()
    curvature = float(np.median(second)) / (2.0 * spacing**2)
    return round(curvature, 3)


def solve_on_grids(
    problem: Problem, shapes: Sequence[tuple[int, int, int]]
) -> list[tuple[Solution, Trajectory]]:
    """The solutions on grids from coarse to fine, and their policies' episodes from `STARTS`."""
    friction = min(problem.mu, 0.3)
    # Contains any solution; the solutions that follow are over the ranges of its trajectories.
    w = (-3.0 - 25.0 * friction, 8.0 + 35.0 * friction)
    grid = Grid(shapes[0], INITIAL_Y, w, problem.q)
    solution = solve(problem, grid)
    trajectory = run_policy(solution, STARTS)
    curvature = curvature_of(solution, trajectory)
    y, w = ranges(trajectory, grid.q)
    results = []
    for shape in shapes:
        finer = replace(grid, shape=divide_nodes(shape, y, w), y=y, w=w)
        solution = solve(problem, finer, curvature=curvature, start=solution)
        trajectory = run_policy(solution, STARTS, final=final_solutions(solution))
        results.append((solution, trajectory))
    return results
