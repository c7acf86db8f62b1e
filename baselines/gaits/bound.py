r"""An upper bound of the mean speed that needs no search.

Claim. Whatever the torque does, as long as it stays within its limit, the pendulum within +-pi/2 and the platform on
the floor, the mean speed from rest over a time T is at most `speed_bound`.

Proof. Let a = m l / (M + m), and v the velocity of the centre of mass, so that

    x' = v + a cos(theta) theta'.

1. Phase plane. Where theta' > 0 the square E = theta'^2 obeys dE/dtheta = 2 theta'', and theta'' at given theta and
   theta' is at most F, its largest value over both directions of slip and stick with u at its upper limit (theta''
   grows with u in each of them: the determinant of the slip equations is positive where Painleve's paradox is
   excluded; and it is monotonic in the friction coefficient, a ratio of two linear functions of it). Every course
   through theta' > 0 has left theta' = 0 somewhere in [-pi/2, pi/2]. By comparison it stays below the solution E_max
   of dE/dtheta = 2 F that starts with E = 0 at -pi/2 and is held at E >= 0. The plant is its own mirror image (theta,
   x, u -> -theta, -x, -u), so theta' < 0 obeys the same envelope, mirrored. With unequal friction coefficients F takes
   the larger one for both directions, which keeps the mirror image.
2. Invariance. By 1, x' >= v - a W, with W the largest cos(theta) sqrt(E_max(theta)). While v > a W the platform
   therefore slides forwards and friction can only slow the centre of mass. From rest v never exceeds a W.
3. Impulse. (M + m) v' = -f with f >= -mu N, and the vertical momentum gives the integral of N up to t as
   (M + m) g t + m z', where z' = -l sin(theta) theta' is the ball's vertical velocity (it starts at rest). So
   v(t) <= mu (g t + m Z / (M + m)), with Z = l times the largest |sin(theta)| sqrt(E_max(|theta|)).
4. The platform's displacement is that of the centre of mass plus a (sin(theta(T)) - sin(theta(0))), at most
   a (1 - sin(theta(0))). Dividing the integral of min(a W, bound of 3) plus that by T gives the bound.

It is crude: 2 lets the pendulum throw the platform back with its largest speed at every instant. The envelope is
integrated numerically, with a step whose error (about 1e-6 of the result, by halving) is covered by a margin of 1e-4.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from capsule_gym.dynamics import accelerations
from capsule_gym.parameters import Capsule, Plant, check_number
from capsule_gym.task import CONTROL_DT, EPISODE_STEPS, START_THETA, THETA_LIMIT, TORQUE_LIMIT

ENVELOPE_STEPS = 600
MARGIN = 1.0 + 1e-4


class Envelope(NamedTuple):
    """The largest rate of the pendulum at every angle, for rates > 0; mirrored for rates < 0.

    Attributes:
        theta: from -pi/2 to pi/2, rad.
        theta_dot: rad/s.
    """

    theta: np.ndarray
    theta_dot: np.ndarray


@lru_cache(maxsize=256)
def _envelope(p: Plant, torque_limit: float) -> Envelope:
    def slope(theta: float, square: float) -> float:
        rate = math.sqrt(max(0.0, square))
        return 2.0 * max(accelerations(theta, rate, slip, torque_limit, p)[0] for slip in (-1.0, 0.0, 1.0))

    theta = np.linspace(-THETA_LIMIT, THETA_LIMIT, ENVELOPE_STEPS + 1)
    h = 2.0 * THETA_LIMIT / ENVELOPE_STEPS
    squares = [0.0]
    for angle in theta[:-1].tolist():
        square = squares[-1]
        s1 = slope(angle, square)
        s2 = slope(angle + 0.5 * h, square + 0.5 * h * s1)
        s3 = slope(angle + 0.5 * h, square + 0.5 * h * s2)
        s4 = slope(angle + h, square + h * s3)
        squares.append(max(0.0, square + h / 6.0 * (s1 + 2.0 * (s2 + s3) + s4)))
    return Envelope(theta, np.sqrt(np.array(squares)))


def phase_plane_envelope(
    M: float, mu: float, torque_limit: float = TORQUE_LIMIT, capsule: Capsule | None = None
) -> Envelope:
    """The largest theta' that a bounded torque reaches at every angle, from rest anywhere: step 1 of the proof.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.
        torque_limit: N m.
        capsule: the plant's other constants.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range.
    """
    torque_limit = check_number("torque_limit", torque_limit, "a finite number > 0 (N m)", 0.0, open_low=True)
    p = (capsule or Capsule()).plant(M, mu)
    largest = p.mu * max(1.0, p.backward_ratio)
    return _envelope(p._replace(mu=largest, backward_ratio=1.0), torque_limit)


def speed_bound(
    M: float,
    mu: float,
    torque_limit: float = TORQUE_LIMIT,
    capsule: Capsule | None = None,
    *,
    horizon: float = EPISODE_STEPS * CONTROL_DT,
) -> float:
    """An upper bound of the mean speed from rest at theta = -pi/3, cm/s; the module's docstring proves it.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.
        torque_limit: N m.
        capsule: the plant's other constants.
        horizon: time that the mean is taken over, s.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range.
    """
    horizon = check_number("horizon", horizon, "a finite number > 0 (s)", 0.0, open_low=True)
    envelope = phase_plane_envelope(M, mu, torque_limit, capsule)
    p = (capsule or Capsule()).plant(M, mu)
    arm = p.m * p.l / (p.M + p.m)
    highest = arm * float((np.cos(envelope.theta) * envelope.theta_dot).max())
    vertical = p.l * float((np.abs(np.sin(envelope.theta)) * envelope.theta_dot).max())
    # What pushes the centre of mass forwards is the friction on a platform that slides or is held backwards.
    grip = p.mu * p.backward_ratio * p.static_ratio
    head_start = grip * p.m * vertical / (p.M + p.m)
    moved = arm * (1.0 - math.sin(START_THETA))
    if head_start >= highest or grip == 0.0:
        travelled = (highest if grip else 0.0) * horizon
    else:
        ramp = min(horizon, (highest - head_start) / (grip * p.g))
        travelled = head_start * ramp + 0.5 * grip * p.g * ramp * ramp + highest * (horizon - ramp)
    return 100.0 * MARGIN * (travelled + moved) / horizon
