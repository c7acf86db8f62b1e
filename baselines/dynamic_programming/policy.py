"""Policies that look one step ahead with stored values.

A policy tries a few dozen torques in the environment's own step, on the plant that it assumes, and
takes the one with the largest reward plus value of the next state. The values are those of the
coarse grids. `dp-nominal` and `dp-oracle` are scripted policies; `PlantOracle` knows all constants
of its plants and the motor, and serves as an expert.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from baselines.dynamic_programming.archive import known_results
from baselines.dynamic_programming.grid import clamped, coordinates, interpolate, q_of
from baselines.dynamic_programming.problem import (
    NOMINAL_MARGIN,
    Problem,
    Transitions,
    corner_weights,
    plant_problems,
)
from baselines.dynamic_programming.solver import Solution, cell_curvature
from capsule_gym.core.layout import Row
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation.optimum import GRID, PlantGrid
from capsule_gym.parameters import NOMINAL

Act = Callable[[np.ndarray], np.ndarray]

# Torques, divided by their limit, that a policy tries; float32 like the environment's actions.
NUM_TORQUES = 41
TORQUES = np.linspace(-1.0, 1.0, NUM_TORQUES).astype(np.float32)
FAILURE_SCORE = -1e6  # cm
# N: the observation is coarser than the state, so a smaller predicted force may be a loss of
# contact.
MIN_NORMAL_FORCE = 0.02


class StoredValues:
    """The values of the states of `count` environments, from one or several solutions for each.

    Attributes:
        q: m l / (M + m) of every environment, m, shape (count,).
        corners: indices of the solutions of every environment, shape (count, n).
        weights: their weights, of the same shape.
    """

    def __init__(self, solutions: Sequence[Solution], count: int, corners: int = 1) -> None:
        grids = [solution.grid for solution in solutions]
        curvatures = [cell_curvature(solution.curvature, solution.grid) for solution in solutions]
        values = [solution.values.ravel() for solution in solutions]
        sizes = [own.size for own in values]
        # The values of all solutions, one after the other, and the indices of the first.
        self._values = np.concatenate(values)
        self._starts = np.cumsum([0, *sizes[:-1]])
        self._shapes = np.array([grid.shape for grid in grids])
        self._axes = np.array([grid.axes for grid in grids])
        self._curvatures = np.array(curvatures)
        self.q = np.full(count, q_of(NOMINAL.M))
        self.corners = np.zeros((count, corners), np.int64)
        self.weights = np.ones((count, corners))

    def add(self, scores: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Adds the values of states theta, theta_dot and x_dot to scores in cm.

        The shapes are (3, count, n) and (count, n).
        """
        own = coordinates(states, self.q[:, None])
        for corner, weight in zip(self.corners.T, self.weights.T, strict=True):
            # Shapes (3, environments, 1).
            first, spacing = self._axes[corner].transpose(2, 1, 0)[..., None]
            nodes = self._shapes[corner].T[..., None]
            positions = [
                clamped((own[n] - first[n]) / spacing[n], nodes[n] - 1.0) for n in range(3)
            ]
            curvature = self._curvatures[corner, None]
            start = self._starts[corner, None]
            found = interpolate(self._values, positions, nodes, curvature, start)
            scores = scores + weight[:, None] * found
        return scores

    def score(self, rewards: np.ndarray, ends: np.ndarray, failed: np.ndarray) -> np.ndarray:
        """The reward plus value of the next state, cm, of each of `TORQUES`, (count, torques).

        Args:
            rewards: rewards of the steps, cm, shape (count * torques,).
            ends: the next states, shape (3, count * torques).
            failed: whether the steps fail, shape (count * torques,).
        """
        # A failed step may end in NaN, which has no cell.
        reached = np.where(failed, 0.0, ends).reshape(3, -1, NUM_TORQUES)
        scores = self.add(rewards.reshape(-1, NUM_TORQUES), reached)
        return np.where(failed.reshape(scores.shape), FAILURE_SCORE, scores)


class Lookahead:
    """The policy on the nominal plant, for `count` environments.

    Its torques leave a `margin` of normal force, N.
    """

    def __init__(self, count: int, margin: float, *problems: Problem, corners: int = 1) -> None:
        solutions = [known_results().solution(problem) for problem in problems]
        self.values = StoredValues(solutions, count, corners)
        assumed = Problem(margin=margin, static_ratio=problems[0].static_ratio)
        self._transitions = Transitions(assumed, count * NUM_TORQUES)
        self._actions = np.tile(TORQUES.astype(np.float64), count)

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """The reward plus value of the next state, cm, of each of `TORQUES`.

        Shape (count, torques).
        """
        states = observations[:, :3].T.astype(np.float64)
        repeated = np.repeat(states, NUM_TORQUES, axis=1)
        ends, rewards, failed = self._transitions.step(repeated, self._actions)
        return self.values.score(rewards, ends, failed)

    @property
    def normal_force(self) -> np.ndarray:
        """The smallest normal force in each step of the last scores, N, shape (count, torques)."""
        return self._transitions.normal_force.reshape(-1, NUM_TORQUES)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The actions for observations of shape (count, entries): shape (count, 1), float32."""
        return TORQUES[self.scores(observations).argmax(axis=1)][:, None]


class Oracle(Lookahead):
    """The policy that observes the plants, M and mu, at the end of an observation.

    Their static ratio is the grid's.
    """

    def __init__(self, count: int, grid: PlantGrid = GRID) -> None:
        super().__init__(count, MIN_NORMAL_FORCE, *plant_problems(grid), corners=4)
        self._grid = grid
        self._observed = np.zeros((count, 2), np.float32)

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """`Lookahead.scores` on the observed plants."""
        plants = observations[:, -2:]
        # On most steps no plant has changed.
        changed = np.flatnonzero((plants != self._observed).any(axis=1))
        if changed.size:
            self._observed[:] = plants
            M, mu = plants.T.astype(np.float64)
            self._transitions.set_plants(np.repeat(M, NUM_TORQUES), np.repeat(mu, NUM_TORQUES))
            self.values.q = q_of(M)
            for i in changed:
                corners, along_M, along_mu = self._grid.cell(float(M[i]), float(mu[i]))
                self.values.corners[i] = corners
                self.values.weights[i] = corner_weights(along_M, along_mu)
        return super().scores(observations)


class PlantOracle:
    """The lookahead on the plant and the motor of every environment, with that plant's own values.

    It reads the whole state of a simulation, also the torque that the motor still exerts. Values
    and lookahead belong to the same plant: an exact lookahead with values of the nominal m, l, k
    and c is slower than none.
    """

    def __init__(self, simulation: Simulation, solutions: Sequence[Solution]) -> None:
        """Makes the policy of a simulation whose plants have these solutions, by M and mu."""
        self._simulation = simulation
        self._solutions = list(solutions)
        count = simulation.num_envs
        self._values = StoredValues(solutions, count)
        self._plants = np.zeros((2, count))
        # The reward of the speed problem, the progress alone; a failed step has its own score.
        options = replace(simulation.options, stack_size=1, energy_weight=0.0)
        self._ahead = Simulation(count * NUM_TORQUES, options)
        self._actions = np.tile(TORQUES.astype(np.float64), count)
        numbers: dict[tuple[float, float], int] = {}
        for n, solution in enumerate(self._solutions):
            numbers[solution.problem.M, solution.problem.mu] = n
        self._numbers = numbers

    def scores(self) -> np.ndarray:
        """`Lookahead.scores` from the present states of the simulation."""
        self._find_plants()
        # What follows is the memory of the sensors.
        state = self._simulation.rows(0, Row.read_before_x + 1)
        for row, values in enumerate(state):
            self._ahead.write(row, np.repeat(values, NUM_TORQUES))
        # The lookahead from a state at which an episode has ended has no use.
        self._ahead.write(Row.termination, np.zeros(self._ahead.num_envs))
        self._ahead.step(self._actions)
        theta, theta_dot, _, x_dot = self._ahead.rows(Row.theta, Row.x_dot + 1)
        failed = self._ahead.row(Row.termination) != 0.0
        failed |= self._ahead.row(Row.normal_force) <= MIN_NORMAL_FORCE
        ends = np.stack([theta, theta_dot, x_dot])
        return self._values.score(self._ahead.row(Row.reward), ends, failed)

    def _find_plants(self) -> None:
        """Assigns a solution to every environment whose M or mu has changed."""
        plants = np.stack([self._simulation.row(Row.M), self._simulation.row(Row.mu)])
        changed = np.flatnonzero((plants != self._plants).any(axis=0))
        self._plants = plants
        for i in changed.tolist():
            M, mu = plants[:, i].tolist()
            number = self._numbers[M, mu]
            self._values.corners[i] = number
            self._values.q[i] = self._solutions[number].problem.q

    @property
    def normal_force(self) -> np.ndarray:
        """The smallest normal force in each step of the last scores, N, shape (count, torques)."""
        return self._ahead.row(Row.normal_force).reshape(-1, NUM_TORQUES)


def start_nominal(seeds: Sequence[int]) -> Act:
    """The policy of the nominal plant, used on every plant, with the margin `NOMINAL_MARGIN`."""
    return Lookahead(len(seeds), NOMINAL_MARGIN, Problem(margin=NOMINAL_MARGIN)).act


def start_oracle(seeds: Sequence[int]) -> Act:
    """The policy that observes the plant."""
    return Oracle(len(seeds)).act
