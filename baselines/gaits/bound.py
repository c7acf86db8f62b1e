r"""An upper bound of the mean speed that needs no search.

Claim. Whatever the torque does, as long as it stays within its limit, the pendulum within +-pi/2 and the platform on
the floor, the mean speed from rest over a time T is at most `speed_bound`.

Proof. Let a = m l / (M + m), and v the velocity of the centre of mass, so that

    x' = v + a cos(theta) theta'.

1. Phase plane. Where theta' > 0, theta' <= E(theta), the envelope of `baselines.envelope` from -pi/2 to pi/2, whose
   docstring proves it. The plant is its own mirror image (theta, x, u -> -theta, -x, -u), so theta' < 0 obeys the same
   envelope, mirrored; with unequal friction coefficients the envelope takes the larger one both ways, which keeps the
   mirror image.
2. Invariance. By 1, x' >= v - a W, with W the largest cos(theta) E(theta). While v > a W the platform
   therefore slides forwards and friction can only slow the centre of mass. From rest v never exceeds a W.
3. Impulse. (M + m) v' = -f with f >= -mu N, and the vertical momentum gives the integral of N up to t as
   (M + m) g t + m z', where z' = -l sin(theta) theta' is the ball's vertical velocity (it starts at rest). So
   v(t) <= mu (g t + m Z / (M + m)), with Z = l times the largest |sin(theta)| E(theta).
4. The platform's displacement is that of the centre of mass plus a (sin(theta(T)) - sin(theta(0))), at most
   a (1 - sin(theta(0))). Dividing the integral of min(a W, bound of 3) plus that by T gives the bound.

It is crude: 2 lets the pendulum throw the platform back with its largest speed at every instant. But it is certified:
the envelope is, and W and Z take between two of its angles the rate of the latter, which is the larger, and the largest
cosine and sine.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from baselines.envelope import Envelope, upper_envelope
from capsule_gym.parameters import Capsule, check_number
from capsule_gym.task import HORIZON, START_THETA, THETA_LIMIT, TORQUE_LIMIT


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
    return upper_envelope(torque_limit, -THETA_LIMIT, THETA_LIMIT, (capsule or Capsule()).plant(M, mu))


def _largest(envelope: Envelope, share: Callable[[np.ndarray], np.ndarray]) -> float:
    """The largest product of the rate and a function of the angle whose slope is at most 1, rad/s."""
    theta, theta_dot = envelope
    between = 0.5 * (theta[1] - theta[0])
    return float(((np.maximum(share(theta[:-1]), share(theta[1:])) + between) * theta_dot[1:]).max())


def speed_bound(
    M: float,
    mu: float,
    torque_limit: float = TORQUE_LIMIT,
    capsule: Capsule | None = None,
    *,
    horizon: float = HORIZON,
) -> float:
    """An upper bound of the mean speed from rest at theta = -pi/3, cm/s; the module's docstring proves it.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.
        torque_limit: N m.
        capsule: the plant's other constants, with Newton's normal force: step 3 rests on it.
        horizon: time that the mean is taken over, s.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range, or the normal force is the paper's.
    """
    horizon = check_number("horizon", horizon, "a finite number > 0 (s)", 0.0, open_low=True)
    p = (capsule or Capsule()).plant(M, mu)
    if p.pivot_torque_on_contact:
        raise ValueError("capsule must have normal_force='newton', got 'paper'")
    envelope = phase_plane_envelope(M, mu, torque_limit, capsule)
    arm = p.m * p.l / (p.M + p.m)
    highest = arm * _largest(envelope, np.cos)
    vertical = p.l * _largest(envelope, lambda theta: np.abs(np.sin(theta)))
    # What pushes the centre of mass forwards is the friction on a platform that slides or is held backwards.
    grip = p.mu * p.backward_ratio * p.static_ratio
    head_start = grip * p.m * vertical / (p.M + p.m)
    moved = arm * (1.0 - math.sin(START_THETA))
    if head_start >= highest or grip == 0.0:
        travelled = (highest if grip else 0.0) * horizon
    else:
        ramp = min(horizon, (highest - head_start) / (grip * p.g))
        travelled = head_start * ramp + 0.5 * grip * p.g * ramp * ramp + highest * (horizon - ramp)
    return 100.0 * (travelled + moved) / horizon
