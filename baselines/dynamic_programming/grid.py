"""The grid of states.

A state (theta, theta_dot, x_dot) becomes (theta, s, w), with q = m l / (M + m):

    w = x_dot / q - cos(theta) theta_dot    the velocity of the centre of mass over q, rad/s
    y = x_dot / (q max(cos(theta), 0.3))    that of the platform, as a rate of the pendulum, rad/s
    s = y / (STRETCH + |y|)                 finer near stick

Only friction changes w, at a low rate. Along x_dot a step would cross many cells, each with an
interpolation error. Stick is the plane s = 0, where the value has a kink; nodes lie on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsule_gym.core.elementary import sincos
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import THETA_LIMIT

STRETCH = 10.0  # rad/s: the y at which the spacing of nodes is four times that at rest
MIN_COSINE = 0.3  # bounds the cosine in y from below
INITIAL_Y = (-10.0, 22.0)  # rad/s: the range of y on the first grid, wider than any solution needs
# Cells: distance of the last position from the last node, so that every position lies in a cell.
EDGE = 1e-4
FAILED = -1.0  # position of a failed state and of a state off the grid
MAX_NODE_RATE = 40.0  # rad/s: of nodes near +-pi/2, where no motion reaches the platform's velocity


def q_of(M: Any, m: float = NOMINAL.m, l: float = NOMINAL.l) -> Any:
    """m l / (M + m) in m, of masses in kg and the length of the pendulum, m."""
    return m * l / (M + m)


def stretched(y: np.ndarray) -> np.ndarray:
    """The coordinate s of y."""
    return y / (STRETCH + abs(y))


def coordinates(
    states: np.ndarray, q: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta, s and w of states theta (rad), theta_dot (rad/s) and x_dot (m/s), shape (3, ..).

    q is m l / (M + m), m.
    """
    theta, theta_dot, x_dot = states
    _, cos = sincos(theta)
    rate = x_dot / q
    y = rate / np.maximum(cos, MIN_COSINE)
    return theta, stretched(y), rate - cos * theta_dot


def clamped(positions: np.ndarray, last: np.ndarray | float) -> np.ndarray:
    """The nearest positions that lie in a cell; `last` is the position of the last node."""
    return np.maximum(0.0, np.minimum(positions, last - EDGE))


def interpolate(
    values: np.ndarray,
    positions: Sequence[np.ndarray],
    nodes: Sequence[Any],
    curvature: Any,
    first: Any = 0,
) -> np.ndarray:
    """The values, flat and float32, at positions on a grid with these nodes along theta, s and w.

    The grid begins at index `first`. Values are linear, and along w less the parabola of
    `cell_curvature`.
    """
    theta, s, w = positions
    i = theta.astype(np.int64)
    j = s.astype(np.int64)
    k = w.astype(np.int64)
    # float32 and float64 hold the remainders exactly.
    theta = theta - i
    s = s - j
    w = w - k
    _, nodes_s, nodes_w = nodes
    along_s = nodes_w
    along_theta = nodes_s * nodes_w

    def along_w(node: np.ndarray) -> np.ndarray:
        value = values[node]
        return value + w * (values[node + 1] - value)

    def along_s_and_w(node: np.ndarray) -> np.ndarray:
        low = along_w(node)
        high = along_w(node + along_s)
        return low + s * (high - low)

    corner = first + i * along_theta + j * along_s + k
    near = along_s_and_w(corner)
    far = along_s_and_w(corner + along_theta)
    linear = near + theta * (far - near)
    return linear - curvature * w * (1.0 - w)


@dataclass(frozen=True)
class Grid:
    """A regular grid over (theta, s, w) for the masses and the length of one plant.

    A state off the grid counts as failed.
    """

    shape: tuple[int, int, int]  # nodes, at least 4 along each
    y: tuple[float, float]  # range around 0, rad/s
    w: tuple[float, float]  # range, rad/s
    q: float  # m l / (M + m), m

    @property
    def axes(self) -> np.ndarray:
        """First node and spacing along theta, s and w, shape (3, 2)."""
        cells_theta, cells_s, cells_w = (count - 1 for count in self.shape)
        low, high = stretched(np.array(self.y)).tolist()
        spacing_s = (high - low) / cells_s
        # A node lies at s = 0.
        first_s = -round(-low / spacing_s) * spacing_s
        along_theta = -THETA_LIMIT, 2.0 * THETA_LIMIT / cells_theta
        low, high = self.w
        along_w = low, (high - low) / cells_w
        return np.array([along_theta, (first_s, spacing_s), along_w])

    def nodes(self) -> np.ndarray:
        """theta, theta_dot and x_dot of all nodes in order, shape (3, nodes)."""
        theta, s, w = (
            first + spacing * np.arange(count)
            for (first, spacing), count in zip(self.axes, self.shape, strict=True)
        )
        s[np.abs(s).argmin()] = 0.0
        theta, s, w = (axis.ravel() for axis in np.meshgrid(theta, s, w, indexing="ij"))
        _, cos = sincos(theta)
        y_cosine = np.maximum(cos, MIN_COSINE)
        rate = y_cosine * STRETCH * s / (1.0 - np.abs(s))
        theta_dot = (rate - w) / np.maximum(cos, 1e-9)
        theta_dot = np.clip(theta_dot, -MAX_NODE_RATE, MAX_NODE_RATE)
        return np.stack([theta, theta_dot, self.q * rate])

    def positions(self, states: np.ndarray) -> np.ndarray:
        """Positions of states of shape (3, n) in cells from the first node, or FAILED.

        Shape (n, 3), float32.
        """
        last = np.array(self.shape) - 1.0
        first, spacing = self.axes.T
        own = np.stack(coordinates(states, self.q), axis=1)
        positions = (own - first) / spacing
        inside = ((positions >= 0.0) & (positions <= last)).all(axis=1)
        found = np.where(inside[:, None], clamped(positions, last), FAILED)
        return found.astype(np.float32)
