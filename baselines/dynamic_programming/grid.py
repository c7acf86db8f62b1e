"""The grid of states: coordinates in which the motion is slow and stick lies on nodes.

A state (theta, theta_dot, x_dot) becomes (theta, s, w), with q = m l / (M + m):

    w = x_dot / q - cos(theta) theta_dot        the velocity of the centre of mass over q, rad/s
    y = x_dot / (q max(cos(theta), 0.3))        the velocity of the platform, as a rate of the pendulum, rad/s
    s = y / (STRETCH + |y|)                     finer near stick

Only friction changes w, at a low rate. Along x_dot a step would cross many cells, each with an interpolation error.
Stick is the plane s = 0, where the value has a kink; nodes lie on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsule_gym.compilation import jitable
from capsule_gym.compiler import compile_cached
from capsule_gym.elementary import sincos, sines_and_cosines
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


@jitable
def stretched(y: float) -> float:
    """The coordinate s of y."""
    return y / (STRETCH + abs(y))


@jitable
def locate(theta: float, theta_dot: float, x_dot: float, q: float, axes: np.ndarray) -> tuple[float, float, float]:
    """The position of a state (rad, rad/s, m/s) in cells from the first node; it may lie off the grid.

    `q` is m l / (M + m) in m; `axes` has first node and spacing of theta (rad), s and w (rad/s), shape (3, 2).
    """
    cos = sincos(theta)[1]
    rate = x_dot / q
    return (
        (theta - axes[0, 0]) / axes[0, 1],
        (stretched(rate / max(cos, MIN_COSINE)) - axes[1, 0]) / axes[1, 1],
        (rate - cos * theta_dot - axes[2, 0]) / axes[2, 1],
    )


@jitable
def clamped(position: float, nodes: int) -> float:
    """The nearest position along an axis that lies in a cell."""
    return max(0.0, min(position, nodes - 1.0 - EDGE))


@jitable
def interpolate(values: np.ndarray, a: float, b: float, c: float, curvature: float) -> float:
    """The value at a position in cells: linear along theta (a) and s (b); along w (c) linear plus a parabola.

    `curvature`: half the second derivative along w, times the square of its spacing.
    """
    i, j, k = int(a), int(b), int(c)
    f, g, w = a - i, b - j, c - k
    low = values[i, j, k] + w * (values[i, j, k + 1] - values[i, j, k])
    high = values[i, j + 1, k] + w * (values[i, j + 1, k + 1] - values[i, j + 1, k])
    near = low + g * (high - low)
    low = values[i + 1, j, k] + w * (values[i + 1, j, k + 1] - values[i + 1, j, k])
    high = values[i + 1, j + 1, k] + w * (values[i + 1, j + 1, k + 1] - values[i + 1, j + 1, k])
    far = low + g * (high - low)
    return near + f * (far - near) - curvature * w * (1.0 - w)


def _locate_all(states: np.ndarray, q: float, axes: np.ndarray, nodes: np.ndarray, positions: np.ndarray) -> None:
    """Writes the position of every column of states, shape (3, n), into positions, shape (n, 3)."""
    for n in range(states.shape[1]):
        position = locate(states[0, n], states[1, n], states[2, n], q, axes)
        inside = True
        for axis in range(3):
            inside = inside and 0.0 <= position[axis] <= nodes[axis] - 1.0
        for axis in range(3):
            positions[n, axis] = clamped(position[axis], nodes[axis]) if inside else FAILED


@dataclass(frozen=True)
class Grid:
    """A regular grid over (theta, s, w) for one mass of the platform; a state off the grid counts as failed.

    Attributes:
        shape: nodes along theta, s and w, at least 4 each.
        y: range of y, rad/s, around 0.
        w: first and last node of w, rad/s.
        M: mass of the platform, kg.
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
        low, high = stretched(self.y[0]), stretched(self.y[1])
        spacing = (high - low) / (self.shape[1] - 1)
        # A node lies at s = 0.
        first = -round(-low / spacing) * spacing
        return np.array(
            [
                (-THETA_LIMIT, 2.0 * THETA_LIMIT / (self.shape[0] - 1)),
                (first, spacing),
                (self.w[0], (self.w[1] - self.w[0]) / (self.shape[2] - 1)),
            ]
        )

    def nodes(self) -> np.ndarray:
        """theta, theta_dot and x_dot of all nodes in order, shape (3, nodes)."""
        theta, s, w = (
            first + spacing * np.arange(n) for (first, spacing), n in zip(self.axes, self.shape, strict=True)
        )
        s[np.abs(s).argmin()] = 0.0
        theta, s, w = (each.reshape(-1) for each in np.meshgrid(theta, s, w, indexing="ij"))
        cos = sines_and_cosines(theta)[1]
        rate = np.maximum(cos, MIN_COSINE) * STRETCH * s / (1.0 - np.abs(s))
        theta_dot = (rate - w) / np.maximum(cos, 1e-9)
        return np.stack([theta, np.clip(theta_dot, -MAX_NODE_RATE, MAX_NODE_RATE), self.q * rate])

    def positions(self, states: np.ndarray) -> np.ndarray:
        """Positions of states of shape (3, n) in cells from the first node, shape (n, 3), float32; or FAILED."""
        out = np.empty((states.shape[1], 3), np.float32)
        columns = np.ascontiguousarray(states, np.float64)
        compile_cached(_locate_all)(columns, self.q, self.axes, np.array(self.shape), out)
        return out
