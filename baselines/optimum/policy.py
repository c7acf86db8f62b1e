"""The scripted policies `optimum-nominal` and `optimum-oracle`: one hold of lookahead, and the values after it.

A policy tries a few dozen torques in the environment's own step, on the plant that it believes in, and takes the one
with the best reward and value of the state it leads to. The values are those of the coarse grids in
`data/values.npz`; between the plants of the grid they are interpolated, linear in M and log(mu).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from baselines.gaits.archive import GRID_M, GRID_MU, log_grid, place
from baselines.optimum import LEAST_CONTACT
from baselines.optimum.grid import confined, interpolate, locate
from baselines.optimum.holds import Holds
from baselines.optimum.records import known_optima
from baselines.optimum.solver import Problem, Solution
from capsule_gym.compilation import compile_cached
from capsule_gym.elementary import log
from capsule_gym.parameters import NOMINAL

Act = Callable[[np.ndarray], np.ndarray]

# Torques tried, evenly spaced over the limits; as coarse as an action that is handed to the environment.
TRIED = 41
TORQUES = np.linspace(-1.0, 1.0, TRIED).astype(np.float32)
# What a torque scores that ends the episode, cm.
FATAL = -1e6
# What `optimum-nominal` leaves between platform and floor, N, so that a lighter platform does not leave it.
NOMINAL_MARGIN = 1.6


def _score(
    states: np.ndarray,
    rewards: np.ndarray,
    dead: np.ndarray,
    q: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    values: np.ndarray,
    shapes: np.ndarray,
    axes: np.ndarray,
    bends: np.ndarray,
    fatal: float,
    scores: np.ndarray,
) -> None:
    """Writes what every environment's torques are worth.

    Args:
        states: after the holds, shape (3, environments torques).
        rewards: of the holds, cm.
        dead: whether they ended the episode.
        q: m l / (M + m) of every environment, m.
        corners: tables around every environment's plant, shape (environments, corners).
        weights: of these, likewise.
        values: of the tables, one behind the other.
        shapes: of the tables, and in a fourth column where they begin.
        axes: shape (tables, 3, 2).
        bends: of the tables, cm.
        fatal: what a torque scores that ends the episode, cm.
        scores: cm, shape (environments, torques); written.
    """
    tried = scores.shape[1]
    for n in range(scores.shape[0]):
        for a in range(tried):
            lane = n * tried + a
            score = rewards[lane]
            if dead[lane]:
                score = fatal
            else:
                for c in range(corners.shape[1]):
                    t = corners[n, c]
                    if weights[n, c] > 0.0:
                        size, begin = shapes[t], shapes[t, 3]
                        end = begin + size[0] * size[1] * size[2]
                        table = values[begin:end].reshape((size[0], size[1], size[2]))
                        i, j, k = locate(states[0, lane], states[1, lane], states[2, lane], q[n], axes[t])
                        value = interpolate(
                            table, confined(i, size[0]), confined(j, size[1]), confined(k, size[2]), bends[t]
                        )
                        score += weights[n, c] * value
            scores[n, a] = score


@lru_cache(maxsize=1)
def _compiled() -> Any:
    """The function above, compiled."""
    return compile_cached(_score)


class Tables:
    """The values of some solutions, ready for the lookahead.

    Args:
        solutions: at least one.
    """

    def __init__(self, solutions: Sequence[Solution]) -> None:
        sizes = [solution.values.size for solution in solutions]
        begins = [sum(sizes[:n]) for n in range(len(sizes))]
        self.values = np.concatenate([solution.values.reshape(-1) for solution in solutions])
        self.shapes = np.array([(*s.grid.shape, begin) for s, begin in zip(solutions, begins, strict=True)])
        self.axes = np.array([solution.grid.axes for solution in solutions])
        self.bends = np.array([solution.bend for solution in solutions])


class Lookahead:
    """The policy for some environments.

    Args:
        count: environments.
        tables: values.
        margin: normal force that a torque must leave, N.
    """

    def __init__(self, count: int, tables: Tables, margin: float) -> None:
        self._tables, self._margin = tables, margin
        self._holds = Holds(count * TRIED, Problem().options)
        self._actions = np.tile(TORQUES.astype(np.float64), count)
        self._scores = np.empty((count, TRIED))

    def believe(self, M: np.ndarray, mu: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> None:
        """Sets the plants: M in kg and mu, shape (count,), the tables around them and their weights, (count, n)."""
        self._holds.set_plants(np.repeat(M, TRIED), np.repeat(mu, TRIED))
        self._q = NOMINAL.m * NOMINAL.l / (M + NOMINAL.m)
        self._corners, self._weights = corners, weights

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """What each torque is worth: its reward and the value after it, cm; `FATAL` where it ends the episode.

        Args:
            observations: shape (count, entries); theta, theta_dot and x_dot come first.

        Returns:
            Shape (count, TRIED), float64, in the order of `TORQUES`; the next call changes it.
        """
        self._holds.put(np.repeat(observations[:, :3].T.astype(np.float64), TRIED, axis=1))
        states, rewards, dead = self._holds.take(self._actions)
        dead |= self._holds.normal_force() <= self._margin
        tables = self._tables
        _compiled()(
            states,
            rewards,
            dead,
            self._q,
            self._corners,
            self._weights,
            tables.values,
            tables.shapes,
            tables.axes,
            tables.bends,
            FATAL,
            self._scores,
        )
        return self._scores

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The actions for observations of shape (count, entries): shape (count, 1), float32."""
        return TORQUES[self.scores(observations).argmax(axis=1)][:, None]


class Oracle(Lookahead):
    """The policy that sees the plants: M and mu are the last two entries of an observation.

    Args:
        count: environments.
        margin: normal force that a torque must leave, N.
    """

    def __init__(self, count: int, margin: float = LEAST_CONTACT) -> None:
        super().__init__(count, _oracle_tables(), margin)
        self._seen = np.zeros((count, 2), np.float32)

    def scores(self, observations: np.ndarray) -> np.ndarray:
        """As of any lookahead, on the plants that the observations show."""
        plants = observations[:, -2:]
        # On most steps no plant has changed.
        if not np.array_equal(plants, self._seen):
            self._seen[:] = plants
            M, mu = plants.T.astype(np.float64)
            around = [surrounding(*plant) for plant in zip(M.tolist(), mu.tolist(), strict=True)]
            corners, weights = zip(*around, strict=True)
            self.believe(M, mu, np.array(corners), np.array(weights))
        return super().scores(observations)


def surrounding(M: float, mu: float) -> tuple[list[int], list[float]]:
    """The plants of the grid around a plant, as places in `PLANTS`, and their weights; outside the grid of its edge."""
    M = min(max(M, GRID_M[0]), GRID_M[-1])
    mu = min(max(mu, GRID_MU[0]), GRID_MU[-1])
    (row, share_M), (column, share_mu) = place(M, GRID_M), place(log(mu), log_grid())
    # The logarithm of an edge may miss it by a digit.
    share_mu = min(max(share_mu, 0.0), 1.0)
    corners = [i * len(GRID_MU) + j for i in (row, row + 1) for j in (column, column + 1)]
    weights = [a * b for a in (1.0 - share_M, share_M) for b in (1.0 - share_mu, share_mu)]
    return corners, weights


@lru_cache(maxsize=1)
def _oracle_tables() -> Tables:
    """The values of every plant of the grid."""
    archive = known_optima()
    return Tables([archive.solution(Problem(M=M, mu=mu)) for M in GRID_M for mu in GRID_MU])


def start_nominal(seeds: Sequence[int]) -> Act:
    """The optimum of the nominal plant that leaves `NOMINAL_MARGIN` of contact, on every plant."""
    count = len(seeds)
    tables = Tables([known_optima().solution(Problem(margin=NOMINAL_MARGIN))])
    lookahead = Lookahead(count, tables, NOMINAL_MARGIN)
    plant = np.full(count, NOMINAL.M), np.full(count, NOMINAL.mu)
    lookahead.believe(*plant, np.zeros((count, 1), np.int64), np.ones((count, 1)))
    return lookahead.act


def start_oracle(seeds: Sequence[int]) -> Act:
    """The optimum of the plant that it is shown; M and mu are the last two observations."""
    return Oracle(len(seeds)).act
