r"""A certified upper bound on the mean speed of any policy: `python -m baselines.paper.speed_bound`.

Let psi = sin(theta), q = m l / (M + m), p = x_dot / q and w = p - psi', the velocity of the centre of mass over q, so
that only friction changes w: w' = -f / (m l). F is a phase with x_dot > 0, B one with x_dot <= 0; w rises in B alone,
and there psi' <= -w. From rest w = 0. Suppose that w passes some W and then W + delta, and look at the time between,
in which W <= w <= W + delta and which begins and ends in B. With N0 = (M + m) g and z = l cos(theta), N = N0 + m z''.

* delta <= (mu / m l) (sum over B of I - sum over F of I), where I is the integral of N.
* Where a phase meets the next, p = 0 and so z' = l w tan(theta). In B I <= N0 (psi_start - psi_end) / W + m [z'].
* N >= 0 excludes that F begins at an angle > 0 with cos^3 < w^2 m l / N0, or ends at such an angle < 0. So, with
  P(theta, w) = N0 psi / W - m l w tan(theta) and Q the largest P from 0 to theta (its mirror image where theta < 0),
  I <= Q(start) - Q(end) in every B.
* If Q(end) - Q(start) <= I in every F as well, the sums telescope: delta <= 2 (mu / m l) max Q. A larger delta is a
  contradiction, and w never exceeds W + delta. F must turn p from 0 back to 0, with p' between bounds over all angles
  and torques; that takes a least time T for a given psi_end - psi_start > 0 (for others the inequality holds), and
  I >= (N0 T + m l W (tan(end) - tan(start))) / (1 + mu tan+(start)).

The angles are divided into cells, bounds on p' are interval arithmetic, and rates of the pendulum are bounded by the
envelope of `baselines.paper.proofs`: a proof up to rounding.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.paper.proofs import swing_envelope
from capsule_gym.command_line import parse
from capsule_gym.parameters import NOMINAL, Capsule
from capsule_gym.task import HORIZON, START_THETA, TORQUE_LIMIT

PROG = "python -m baselines.paper.speed_bound"
# Cells of the angle, and their width for psi' and p, rad/s.
CELLS, WIDTH = 1200, 0.05
STEP = 0.05  # between the tried values of W, rad/s

Interval = tuple[np.ndarray, np.ndarray]


class Accelerations(NamedTuple):
    """Bounds on p' in F for each cell of psi', rad/s^2, and on the pendulum's rate at the lower ends of the angles."""

    rates: np.ndarray
    highest: np.ndarray
    lowest: np.ndarray
    theta: np.ndarray
    envelope: np.ndarray


def _times(a: Interval, b: Interval) -> Interval:
    products = [x * y for x in a for y in b]
    return np.minimum.reduce(products), np.maximum.reduce(products)


def bound_accelerations(capsule: Capsule) -> Accelerations:
    """Bounds on p' over all angles, torques and rates below the envelope, by interval arithmetic.

    In F Newton's equations give p' = ((cos + mu sin) tau / (m l^2) - (sin - mu cos) theta_dot^2 - mu g / q) / D with
    D = 1 - m / (M + m) cos (cos + mu sin) and the pivot's torque tau.
    """
    M, m, l, g, mu = capsule.M, capsule.m, capsule.l, capsule.g, capsule.mu
    envelope = swing_envelope(TORQUE_LIMIT, -math.pi / 2.0, math.pi / 2.0, capsule)
    theta = np.linspace(-math.pi / 2.0, math.pi / 2.0, CELLS + 1)
    low, high = theta[:-1], theta[1:]
    # The envelope never decreases.
    above = np.minimum(np.searchsorted(envelope.theta, theta), envelope.theta.size - 1)
    fastest = envelope.theta_dot[above]
    sin = np.sin(low), np.sin(high)
    ends = np.cos(low), np.cos(high)
    # CELLS is even: 0 is an end of a cell.
    cos = np.maximum(np.minimum(*ends), 1e-12), np.maximum(*ends)
    limit = math.ceil(envelope.fastest / WIDTH)
    rates = WIDTH * np.arange(-limit, limit + 1)
    first, last = rates[:-1, None], rates[1:, None]
    slowest = np.maximum(np.where(first >= 0.0, first / cos[1], first / cos[0]), -fastest[::-1][:-1])
    quickest = np.minimum(np.where(last >= 0.0, last / cos[0], last / cos[1]), fastest[1:])
    possible = slowest <= quickest
    squares = _times((slowest, quickest), (slowest, quickest))
    squares = np.maximum(squares[0], 0.0), squares[1]
    push = cos[0] + mu * sin[0], cos[1] + mu * sin[1]
    pull = sin[0] - mu * cos[1], sin[1] - mu * cos[0]
    product = _times(cos, push)
    share = m / (M + m)
    inverse = 1.0 / (1.0 - share * product[0]), 1.0 / (1.0 - share * product[1])
    centrifugal = _times(pull, squares)
    found = []
    for u in (TORQUE_LIMIT, -TORQUE_LIMIT):
        tau = (
            u + m * g * l * sin[0] - capsule.k * high - capsule.c * quickest,
            u + m * g * l * sin[1] - capsule.k * low - capsule.c * slowest,
        )
        motor = _times(push, tau)
        drag = mu * g * (M + m) / (m * l)
        top = motor[0] / (m * l * l) - centrifugal[1] - drag, motor[1] / (m * l * l) - centrifugal[0] - drag
        found.append(_times(top, inverse))
    highest = np.where(possible, found[0][1], -np.inf).max(axis=1)
    lowest = np.where(possible, found[1][0], np.inf).min(axis=1)
    return Accelerations(rates, highest, lowest, theta, fastest)


def excess(W: float, capsule: Capsule, bounds: Accelerations) -> tuple[float, float]:
    """An upper bound on Q(end) - Q(start) - I of a phase F, N s, and delta, rad/s; W in rad/s."""
    ml, weight, mu = capsule.m * capsule.l, (capsule.M + capsule.m) * capsule.g, capsule.mu
    # Where a phase meets the next, |theta_dot| = w / cos(theta) is below the envelope towards smaller angles.
    theta, cos = bounds.theta, np.maximum(np.cos(bounds.theta), 1e-12)
    theta = theta[bounds.envelope[::-1] * cos >= 0.9 * W]
    peak = math.acos(min((W * W * ml / weight) ** (1.0 / 3.0), 1.0))
    clipped = np.clip(theta, -peak, peak)
    Q = weight * np.sin(clipped) / W - ml * W * np.tan(clipped)
    delta = 2.0 * mu / ml * (weight * math.sin(peak) / W - ml * W * math.tan(peak))
    # The least time for a gain of psi: p accelerates and brakes as fast as possible, through cells of p.
    p = WIDTH * np.arange(math.ceil((bounds.rates[-1] + W + delta) / WIDTH))
    lower = np.floor((p - W - delta - bounds.rates[0]) / WIDTH).astype(int)
    upper = np.ceil((p + WIDTH - W - bounds.rates[0]) / WIDTH).astype(int)
    spans = [slice(max(a, 0), max(b, 0)) for a, b in zip(lower.tolist(), upper.tolist(), strict=True)]
    forwards = np.array([bounds.highest[span].max(initial=-np.inf) for span in spans])
    backwards = -np.array([bounds.lowest[span].min(initial=np.inf) for span in spans])
    count = int(np.argmin((forwards > 0.0) & (backwards > 0.0))) or p.size
    durations = WIDTH / forwards[:count] + WIDTH / backwards[:count]
    times = np.concatenate([[0.0], np.cumsum(durations)])
    gains = np.cumsum(durations * (p[:count] + WIDTH)) - W * times[:-1]
    # psi' = p - w < 0 as long as p < W.
    gains = np.maximum.accumulate(np.where(p[:count] + WIDTH <= W, -np.inf, gains))
    # Over cells of the two angles: bounds at their worse ends.
    start, end = slice(None, -1), slice(1, None)
    least = np.sin(theta[None, start]) - np.sin(theta[end, None])
    cell = np.searchsorted(gains, np.maximum(least, 0.0))
    shortest = np.where(cell < gains.size, times[np.minimum(cell, gains.size - 1)], np.inf)
    slope = mu * np.maximum(np.tan(theta[end, None]), 0.0)
    turned = ml * W * (np.tan(theta[None, start]) - np.tan(theta[end, None]))
    impulse = (weight * shortest + turned) * (1.0 - slope) / (1.0 + slope)
    found = Q[None, end] - Q[start, None] - np.maximum(impulse, 0.0)
    central = np.abs(theta) <= peak
    allowed = (central[start] | (theta[start] < 0.0))[:, None] & (central[end] | (theta[end] > 0.0))[None]
    rising = theta[None, end] > theta[start, None]
    return float(np.where(allowed & rising, found, -np.inf).max()), delta


def bound_speed(capsule: Capsule = NOMINAL) -> tuple[float, float]:
    """Upper bounds on the mean speed in the long run and over an episode from the task's start, cm/s.

    The plant must have one friction coefficient for stick and both directions. The bounds are infinite where the
    argument fails.
    """
    bounds, q = bound_accelerations(capsule), capsule.m * capsule.l / (capsule.M + capsule.m)
    # Above the first mu tan(theta) < 1 wherever p = 0; below the second the window's ends cost no more than max Q.
    fastest = float(bounds.envelope[-1])
    low = fastest / math.sqrt(1.0 + 1.0 / capsule.mu**2)
    high = (capsule.M + capsule.m) * capsule.g / (capsule.m * capsule.l * fastest)
    found = [(W, *excess(W, capsule, bounds)) for W in np.arange(low + STEP, high, STEP).tolist()]
    largest = min((W + delta for W, violation, delta in found if violation <= 0.0), default=math.inf)
    steady = 100.0 * q * largest
    return steady, steady + 100.0 * q * (1.0 + abs(math.sin(START_THETA))) / HORIZON


@dataclass(frozen=True)
class Args:
    """Prints a certified upper bound on the mean speed of any policy on a plant.

    Examples:
      python -m baselines.paper.speed_bound
      python -m baselines.paper.speed_bound --M 0.75 --mu 0.005
    """

    M: float = NOMINAL.M
    """Mass of the platform, kg."""
    mu: float = NOMINAL.mu
    """Friction coefficient."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    steady, episode = bound_speed(Capsule(M=args.M, mu=args.mu))
    print(f"at most {steady:.2f} cm/s in the long run, {episode:.2f} cm/s over {HORIZON:g} s from rest")
    return 0


if __name__ == "__main__":
    sys.exit(main())
