"""Two proofs that the published torques cannot give the published velocities on the published plant.

Neither knows the reference, the gains or the law: they hold for every motor torque that stays within the limit. Both
are certified: what is sampled is widened by a bound on what happens between the samples. They cover either direction
of slip, stick, and both options for the normal force. What they bound is the torque against the rate; the mean speed
they leave open.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from baselines.envelope import Envelope, upper_envelope
from baselines.paper import published
from baselines.paper.selection import bisect
from capsule_gym import dynamics
from capsule_gym.parameters import Capsule, NormalForce, Plant
from capsule_gym.task import START_THETA

SAMPLES = 20_001
BISECTIONS = 22
# N m; reaches every published velocity.
STRONGEST = 4.0
# ms; a swing that takes longer has come to rest.
LONGEST_SWING = 2000


def torque_without_acceleration(theta: np.ndarray, theta_dot: float, slip: float, p: Plant) -> np.ndarray:
    """Motor torque in N m at theta'' = 0, from Eq. (1).

    Args:
        theta: angles, rad.
        theta_dot: rate, rad/s.
        slip: +1.0 or -1.0 for the direction of slip, 0.0 for stick.
        p: the plant.
    """
    ml = p.m * p.l
    sin, cos = np.sin(theta), np.cos(theta)
    at_rest = -ml * p.g * sin + p.k * theta + p.c * theta_dot
    if slip == 0.0:
        return at_rest
    normal = (p.M + p.m) * p.g - ml * theta_dot**2 * cos
    normal -= p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin  # Eq. (7)
    friction = slip * p.mu * np.maximum(0.0, normal)
    return at_rest + ml * cos * (ml * sin * theta_dot**2 + friction) / (p.M + p.m)  # Eq. (32)


def _slope_of_torque(largest_theta: float, theta_dot: float, p: Plant) -> float:
    """Bound on |d torque / d theta| of `torque_without_acceleration` in N m/rad, for |theta| <= largest_theta."""
    ml, total = p.m * p.l, p.M + p.m
    pivot = p.k * largest_theta + p.c * abs(theta_dot)
    centrifugal = ml * theta_dot**2
    friction = p.mu * (total * p.g + 2.0 * centrifugal + 2.0 * pivot + p.k)
    return ml * p.g + p.k + ml * (centrifugal + friction) / total


def torque_at_peak(
    velocity: float, low: float, high: float, slips: tuple[float, ...] = (0.0, 1.0, -1.0)
) -> tuple[float, float, str]:
    """Proof 1: a lower bound on the largest torque of every motion whose theta' peaks at a given value.

    Theorem. Let theta' > 0 attain its maximum V at an angle in [low, high]. Then the torque is, at or just before the
    peak, at least min over [low, high] and over the contact modes of the torque of Eq. (1) at theta'' = 0, theta' = V.

    Argument. In every mode Eq. (1) gives u = J theta'' + u_0(theta, theta') with J > 0: m l^2 in stick and
    m l^2 (1 - m cos (cos +- mu sin) / (M + m)) in slip, positive where the contact is regular. Where u is continuous,
    theta'' = 0 at the peak and u = u_0. Where u or the mode jumps there, theta' still grew towards its maximum, so
    theta'' >= 0 at times arbitrarily close before it, and there u >= u_0, which is continuous within a mode. The
    torque's friction enters by N at theta'' = 0, so both options for the normal force are searched.

    The minimum over a grid is lowered by the largest slope times half the spacing, which makes it a bound.

    Args:
        velocity: V, rad/s.
        low: smallest angle of the swing, rad.
        high: largest, rad.
        slips: the contact modes to search.

    Returns:
        The bound in N m, the angle in rad where it is attained, and the mode in words.
    """
    theta = np.linspace(low, high, SAMPLES)
    margin = 0.5 * (theta[1] - theta[0])
    best = (math.inf, 0.0, "")
    for option, p in zip(get_args(NormalForce), _both_contacts(Capsule()), strict=True):
        slope = _slope_of_torque(max(abs(low), abs(high)), velocity, p)
        for slip in slips:
            torque = torque_without_acceleration(theta, velocity, slip, p) - slope * margin
            n = int(torque.argmin())
            mode = "stick" if slip == 0.0 else f"slip {'forwards' if slip > 0.0 else 'backwards'}, N by {option}"
            best = min(best, (float(torque[n]), float(theta[n]), mode))
    return best


def swing_envelope(limit: float, low: float, high: float, capsule: Capsule | None = None) -> Envelope:
    """Proof 2: the envelope of a swing from rest, whichever option for the normal force holds.

    The theorem and its argument are in `baselines.envelope.upper_envelope`.

    Args:
        limit: of the torque, N m.
        low: smallest angle of the swing, rad.
        high: largest, rad.
        capsule: the plant; its option for the normal force does not matter.
    """
    return upper_envelope(limit, low, high, *_both_contacts(capsule or Capsule()))


def _both_contacts(capsule: Capsule) -> list[Plant]:
    """A capsule with each option for the normal force."""
    return [replace(capsule, normal_force=option).plant() for option in get_args(NormalForce)]


def torque_needed(velocity: float, low: float, high: float) -> float:
    """A torque in N m with which no motion from rest at `low` reaches a velocity (rad/s) before `high`, nor with less.

    The largest that bisection finds whose certified envelope stays below the velocity: a motion with less torque keeps
    within this limit as well.
    """
    return bisect(lambda torque: swing_envelope(torque, low, high).fastest < velocity, 0.0, STRONGEST, BISECTIONS)[0]


def torque_enough(velocity: float, low: float, high: float) -> float:
    """A constant torque in N m that takes the capsule from rest at `low` to a velocity (rad/s) before `high`."""
    p = Capsule().plant()

    def fails(torque: float) -> bool:
        theta, theta_dot, x, x_dot = low, 0.0, 0.0, 0.0
        for _ in range(LONGEST_SWING):
            theta, theta_dot, x, x_dot = dynamics.step(theta, theta_dot, x, x_dot, torque, p, 1e-3)[:4]
            if theta_dot >= velocity or theta_dot <= 0.0 or theta >= high:
                break
        return theta_dot < velocity

    return bisect(fails, 0.0, STRONGEST, BISECTIONS)[1]


def check_proof_1() -> list[dict[str, Any]]:
    """Proof 1 for the proposed profile and for EPC.

    Returns:
        By profile: its `name`; the published peak `velocity` (rad/s) and largest torque (`published`, N m); the
        certified lower bound on the torque at the peak (`bound`, N m), the `angle` where it is smallest (rad) and the
        contact there (`mode`); the same bound for a platform at rest (`sticking`); and whether the published torque is
        below the bound (`holds`).
    """
    found = []
    for name, numbers in published.RUNS.items():
        velocity, torque = numbers["peak_velocity"].value, numbers["peak_torque"].value
        swing = (START_THETA, math.radians(numbers["swing"].value))
        bound, angle, mode = torque_at_peak(velocity, *swing)
        row = {"name": name, "velocity": velocity, "published": torque, "bound": bound, "angle": angle, "mode": mode}
        row["sticking"], _, _ = torque_at_peak(velocity, *swing, slips=(0.0,))
        found.append({**row, "holds": torque < bound})
    return found


def check_proof_2() -> list[dict[str, Any]]:
    """Proof 2 for the proposed profile and for EPC.

    Returns:
        By profile: its `name`; the published largest `torque` (N m) and peak velocity (`published`, rad/s); the
        certified upper bound on theta' under that torque from rest anywhere in +-swing (`bound`, rad/s), from rest at
        -60 degrees (`from_start`) and from there without the damper (`undamped`); the certified lower bound on the
        torque that reaches the published velocity from -60 degrees (`torque_needed`, N m) and a constant torque that
        does, by simulation (`torque_enough`); and whether the published velocity is above the bound (`holds`).
    """
    found = []
    for name, numbers in published.RUNS.items():
        velocity, limit = numbers["peak_velocity"].value, numbers["peak_torque"].value
        largest = math.radians(numbers["swing"].value)
        swing = (START_THETA, largest)
        row: dict[str, Any] = {"name": name, "torque": limit, "published": velocity}
        row["bound"] = swing_envelope(limit, -largest, largest).fastest
        row["from_start"] = swing_envelope(limit, *swing).fastest
        row["torque_needed"] = torque_needed(velocity, *swing)
        row["torque_enough"] = torque_enough(velocity, *swing)
        row["undamped"] = swing_envelope(limit, *swing, Capsule(c=0.0)).fastest
        found.append({**row, "holds": velocity > row["bound"]})
    return found
