"""The grid of states.

A state (theta, theta_dot, x_dot) becomes (theta, s, w), with q = m l / (M + m):

    w = x_dot / q - cos(theta) theta_dot        the velocity of the centre of mass over q, rad/s
    y = x_dot / (q max(cos(theta), 0.3))        the velocity of the platform, as a rate of the pendulum, rad/s
    s = y / (STRETCH + |y|)                     finer near stick

Only friction changes w, at a low rate. Along x_dot a step would cross many cells, each with an interpolation error.
Stick is the plane s = 0, where the value has a kink; nodes lie on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capsule_gym.elementary import sincos
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import THETA_LIMIT

# rad/s: the y at which the spacing of nodes is four times that at rest.
STRETCH = 10.0
# Bounds the cosine in y from below.
MIN_COSINE = 0.3
# rad/s: the range of y on the first grid, wider than any solution needs.
INITIAL_Y = (-10.0, 22.0)
# Cells: distance of the last position from the last node, so that every position lies in a cell.
EDGE = 1e-4
# Position of a failed state and of a state off the grid.
FAILED = -1.0
# rad/s: limit of the rate of nodes near +-pi/2, where no motion reaches the platform's velocity.
MAX_NODE_RATE = 40.0


def stretched(y: np.ndarray) -> np.ndarray:
    """The coordinate s of y."""
    return y / (STRETCH + abs(y))


def coordinates(states: np.ndarray, q: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta, s and w of states theta (rad), theta_dot (rad/s) and x_dot (m/s), shape (3, ..); q is m l / (M + m), m."""
    theta, theta_dot, x_dot = states
    cos, rate = sincos(theta)[1], x_dot / q
    return theta, stretched(rate / np.maximum(cos, MIN_COSINE)), rate - cos * theta_dot


def clamped(positions: np.ndarray, last: np.ndarray | float) -> np.ndarray:
    """The nearest positions that lie in a cell; `last` is the position of the last node."""
    return np.maximum(0.0, np.minimum(positions, last - EDGE))


class Cells(NamedTuple):
    """The first node's index in the flat array of values, strides to the next along theta and s, and shares 0 to 1."""

    corner: np.ndarray
    strides: tuple[np.ndarray | int, np.ndarray | int]
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


def find_cells(
    positions: tuple[np.ndarray, ...], nodes_s: np.ndarray | int, nodes_w: np.ndarray | int, first: np.ndarray | int = 0
) -> Cells:
    """The cells of positions on the grid along theta, s and w; the values begin at the index `first`."""
    # float32 and float64 hold the remainders exactly.
    i, j, k = (position.astype(np.int64) for position in positions)
    a, b, c = (position - index for position, index in zip(positions, (i, j, k), strict=True))
    stride = nodes_s * nodes_w
    return Cells(first + i * stride + j * nodes_w + k, (stride, nodes_w), a, b, c)


def interpolate(values: np.ndarray, cells: Cells, curvature: np.ndarray | float) -> np.ndarray:
    """The values, flat and float32, in cells: linear, and along w less the parabola of `cell_curvature`."""
    (along_theta, along_s), w = cells.strides, cells.c

    def along_w(node: np.ndarray) -> np.ndarray:
        value = values[node]
        return value + w * (values[node + 1] - value)

    def along_s_and_w(node: np.ndarray) -> np.ndarray:
        low, high = along_w(node), along_w(node + along_s)
        return low + cells.b * (high - low)

    near, far = along_s_and_w(cells.corner), along_s_and_w(cells.corner + along_theta)
    return near + cells.a * (far - near) - curvature * w * (1.0 - w)


@dataclass(frozen=True)
class Grid:
    """A regular grid over (theta, s, w) for one mass of the platform (kg); a state off the grid counts as failed.

    It has `shape` nodes, at least 4 along each, and spans a range of y around 0 and of w, rad/s.
    """

    shape: tuple[int, int, int]
    y: tuple[float, float]
    w: tuple[float, float]
    M: float

    @property
    def q(self) -> float:
        """m l / (M + m), m."""
        return NOMINAL.m * NOMINAL.l / (self.M + NOMINAL.m)

    @property
    def axes(self) -> np.ndarray:
        """First node and spacing along theta, s and w, shape (3, 2)."""
        low, high = stretched(np.array(self.y)).tolist()
        spacing = (high - low) / (self.shape[1] - 1)
        # A node lies at s = 0.
        first = -round(-low / spacing) * spacing
        along_theta = -THETA_LIMIT, 2.0 * THETA_LIMIT / (self.shape[0] - 1)
        along_w = self.w[0], (self.w[1] - self.w[0]) / (self.shape[2] - 1)
        return np.array([along_theta, (first, spacing), along_w])

    def nodes(self) -> np.ndarray:
        """theta, theta_dot and x_dot of all nodes in order, shape (3, nodes)."""
        theta, s, w = (a + spacing * np.arange(n) for (a, spacing), n in zip(self.axes, self.shape, strict=True))
        s[np.abs(s).argmin()] = 0.0
        theta, s, w = (each.reshape(-1) for each in np.meshgrid(theta, s, w, indexing="ij"))
        cos = sincos(theta)[1]
        rate = np.maximum(cos, MIN_COSINE) * STRETCH * s / (1.0 - np.abs(s))
        theta_dot = (rate - w) / np.maximum(cos, 1e-9)
        return np.stack([theta, np.clip(theta_dot, -MAX_NODE_RATE, MAX_NODE_RATE), self.q * rate])

    def positions(self, states: np.ndarray) -> np.ndarray:
        """Positions of states of shape (3, n) in cells from the first node, shape (n, 3), float32; or FAILED."""
        last = np.array(self.shape) - 1.0
        first, spacing = self.axes.T
        positions = (np.stack(coordinates(states, self.q), axis=1) - first) / spacing
        inside = ((positions >= 0.0) & (positions <= last)).all(axis=1)
        return np.where(inside[:, None], clamped(positions, last), FAILED).astype(np.float32)
