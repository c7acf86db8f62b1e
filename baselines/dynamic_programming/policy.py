"""The scripted policies `dp-nominal` and `dp-oracle`: one-step lookahead with stored values.

A policy tries a few dozen torques in the environment's own step, on the plant that it assumes, and
takes the one with the largest reward plus value of the next state. The values are those of the
coarse grids.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

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
from baselines.dynamic_programming.solver import cell_curvature
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


class _Tables(NamedTuple):
    """The values of several solutions, one after the other, and an entry of each by solution."""

    values: np.ndarray
    starts: np.ndarray  # indices of the first values
    shapes: np.ndarray
    axes: np.ndarray
    curvatures: np.ndarray  # `cell_curvature`


@lru_cache(maxsize=2)
def _tables(*problems: Problem) -> _Tables:
    solutions = [known_results().solution(problem) for problem in problems]
    grids = [solution.grid for solution in solutions]
    curvatures = [cell_curvature(solution.curvature, solution.grid) for solution in solutions]
    values = [solution.values.ravel() for solution in solutions]
    sizes = [own.size for own in values]
    shapes = [grid.shape for grid in grids]
    axes = [grid.axes for grid in grids]
    return _Tables(
        values=np.concatenate(values),
        starts=np.cumsum([0, *sizes[:-1]]),
        shapes=np.array(shapes),
        axes=np.array(axes),
        curvatures=np.array(curvatures),
    )


class Lookahead:
    """The policy on the nominal plant, for `count` environments.

    Its torques leave a `margin` of normal force, N.
    """

    def __init__(self, count: int, margin: float, *problems: Problem) -> None:
        self._tables = _tables(*problems)
        assumed = Problem(margin=margin, static_ratio=problems[0].static_ratio)
        self._transitions = Transitions(assumed, count * NUM_TORQUES)
        self._actions = np.tile(TORQUES.astype(np.float64), count)
        self._q = np.full(count, q_of(NOMINAL.M))
        # The solutions around every environment's plant.
        self._corners = np.zeros((count, 1), np.int64)
        self._weights = np.ones((count, 1))

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """The reward plus value of the next state, cm, of each of `TORQUES`.

        Shape (count, torques).
        """
        states = observations[:, :3].T.astype(np.float64)
        repeated = np.repeat(states, NUM_TORQUES, axis=1)
        ends, rewards, failed = self._transitions.step(repeated, self._actions)
        # A failed step may end in NaN, which has no cell.
        ends = np.where(failed, 0.0, ends).reshape(3, -1, NUM_TORQUES)
        scores = self.add_values(rewards.reshape(-1, NUM_TORQUES), ends)
        return np.where(failed.reshape(scores.shape), FAILURE_SCORE, scores)

    def add_values(self, scores: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Adds the values of states theta, theta_dot and x_dot to scores in cm.

        The shapes are (3, count, n) and (count, n).
        """
        own = coordinates(states, self._q[:, None])
        tables = self._tables
        for corner, weight in zip(self._corners.T, self._weights.T, strict=True):
            # Shapes (3, environments, 1).
            first, spacing = tables.axes[corner].transpose(2, 1, 0)[..., None]
            nodes = tables.shapes[corner].T[..., None]
            positions = [
                clamped((own[n] - first[n]) / spacing[n], nodes[n] - 1.0) for n in range(3)
            ]
            curvature = tables.curvatures[corner, None]
            start = tables.starts[corner, None]
            found = interpolate(tables.values, positions, nodes, curvature, start)
            scores = scores + weight[:, None] * found
        return scores

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
        super().__init__(count, MIN_NORMAL_FORCE, *plant_problems(grid))
        self._grid = grid
        self._observed = np.zeros((count, 2), np.float32)
        self._corners = np.zeros((count, 4), np.int64)
        self._weights = np.zeros((count, 4))

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """`Lookahead.scores` on the observed plants."""
        plants = observations[:, -2:]
        # On most steps no plant has changed.
        changed = np.flatnonzero((plants != self._observed).any(axis=1))
        if changed.size:
            self._observed[:] = plants
            M, mu = plants.T.astype(np.float64)
            self._transitions.set_plants(np.repeat(M, NUM_TORQUES), np.repeat(mu, NUM_TORQUES))
            self._q = q_of(M)
            for i in changed:
                corners, along_M, along_mu = self._grid.cell(float(M[i]), float(mu[i]))
                self._corners[i] = corners
                self._weights[i] = corner_weights(along_M, along_mu)
        return super().scores(observations)


def start_nominal(seeds: Sequence[int]) -> Act:
    """The policy of the nominal plant, used on every plant, with the margin `NOMINAL_MARGIN`."""
    return Lookahead(len(seeds), NOMINAL_MARGIN, Problem(margin=NOMINAL_MARGIN)).act


def start_oracle(seeds: Sequence[int]) -> Act:
    """The policy that observes the plant."""
    return Oracle(len(seeds)).act
