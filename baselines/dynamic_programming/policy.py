"""The scripted policies `dp-nominal` and `dp-oracle`: one-step lookahead with the values of the
solutions.

A policy tries a few dozen torques in the environment's own step, on the plant that it assumes, and
takes the one with the largest reward plus value of the next state. The values are those of the
coarse grids.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from baselines.dynamic_programming.archive import known_results
from baselines.dynamic_programming.grid import clamped, coordinates, interpolate
from baselines.dynamic_programming.problem import (
    NOMINAL_MARGIN,
    Problem,
    Transitions,
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


@lru_cache(maxsize=2)
def _tables(*problems: Problem) -> tuple[np.ndarray, ...]:
    """The values of solutions, one after the other, and the first index, shape, axes and
    `cell_curvature` of each.
    """
    solutions = [known_results().solution(problem) for problem in problems]
    values = [solution.values.reshape(-1) for solution in solutions]
    starts, grids = (
        np.cumsum([0, *(each.size for each in values[:-1])]),
        [solution.grid for solution in solutions],
    )
    curvatures = [cell_curvature(solution.curvature, solution.grid) for solution in solutions]
    return (
        np.concatenate(values),
        starts,
        *map(np.array, ([g.shape for g in grids], [g.axes for g in grids], curvatures)),
    )


class Lookahead:
    """The policy on the nominal plant, for `count` environments; its torques leave a `margin` of
    normal force, N.
    """

    def __init__(self, count: int, margin: float, *problems: Problem) -> None:
        self._tables = _tables(*problems)
        assumed = Problem(margin=margin, static_ratio=problems[0].static_ratio)
        self._transitions = Transitions(assumed, count * NUM_TORQUES)
        self._actions = np.tile(TORQUES.astype(np.float64), count)
        self._q = np.full(count, NOMINAL.m * NOMINAL.l / (NOMINAL.M + NOMINAL.m))
        self._corners, self._weights = np.zeros((count, 1), np.int64), np.ones((count, 1))

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """The reward plus value of the next state, cm, of each of `TORQUES`, shape (count,
        torques).
        """
        states = np.repeat(observations[:, :3].T.astype(np.float64), NUM_TORQUES, axis=1)
        ends, rewards, failed = self._transitions.step(states, self._actions)
        # A failed step may end in NaN, which has no cell.
        ends = np.where(failed, 0.0, ends).reshape(3, -1, NUM_TORQUES)
        scores = self.add_values(rewards.reshape(-1, NUM_TORQUES), ends)
        return np.where(failed.reshape(scores.shape), FAILURE_SCORE, scores)

    def add_values(self, scores: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Adds the values of states theta, theta_dot and x_dot, shape (3, count, n), to scores in
        cm, (count, n).
        """
        own, (values, starts, shapes, axes, curvatures) = (
            coordinates(states, self._q[:, None]),
            self._tables,
        )
        # The tables around every environment's plant.
        for corner, weight in zip(self._corners.T, self._weights.T, strict=True):
            # Shapes (3, environments, 1).
            first, spacing = axes[corner].transpose(2, 1, 0)[..., None]
            nodes = shapes[corner].T[..., None]
            positions = tuple(
                clamped((own[n] - first[n]) / spacing[n], nodes[n] - 1.0) for n in range(3)
            )
            found = interpolate(
                values, positions, nodes, curvatures[corner, None], starts[corner, None]
            )
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
    """The policy that observes the plants, M and mu, at the end of an observation; their static
    ratio is the grid's.
    """

    def __init__(self, count: int, grid: PlantGrid = GRID) -> None:
        super().__init__(count, MIN_NORMAL_FORCE, *plant_problems(grid))
        self._grid = grid
        self._observed = np.zeros((count, 2), np.float32)
        self._corners, self._weights = np.zeros((count, 4), np.int64), np.zeros((count, 4))

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """`Lookahead.scores` on the observed plants."""
        plants = observations[:, -2:]
        # On most steps no plant has changed.
        changed = np.flatnonzero((plants != self._observed).any(axis=1))
        if changed.size:
            self._observed[:] = plants
            M, mu = plants.T.astype(np.float64)
            self._transitions.set_plants(np.repeat(M, NUM_TORQUES), np.repeat(mu, NUM_TORQUES))
            self._q = NOMINAL.m * NOMINAL.l / (M + NOMINAL.m)
            cells = [
                self._grid.cell(*plant)
                for plant in zip(M[changed].tolist(), mu[changed].tolist(), strict=True)
            ]
            self._corners[changed], a, b = (np.array(each) for each in zip(*cells, strict=True))
            self._weights[changed] = np.stack(
                [(1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b], axis=1
            )
        return super().scores(observations)


def start_nominal(seeds: Sequence[int]) -> Act:
    """The policy of the nominal plant, used on every plant; it leaves `NOMINAL_MARGIN` of normal
    force.
    """
    return Lookahead(len(seeds), NOMINAL_MARGIN, Problem(margin=NOMINAL_MARGIN)).act


def start_oracle(seeds: Sequence[int]) -> Act:
    """The policy that observes the plant."""
    return Oracle(len(seeds)).act
