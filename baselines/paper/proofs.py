"""Proof that the published torques cannot give the published velocities on the published plant.

It does not depend on the reference, the gains or the law: it holds for every motor torque that stays within the limit.
It is certified: sampled quantities are widened by a bound on their change between the samples. It covers either
direction of slip, stick, and both options for the normal force. It bounds the torque against the rate, not the mean
speed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from baselines.paper import published
from capsule_gym import dynamics
from capsule_gym.parameters import NOMINAL, NormalForce, Plant
from capsule_gym.task import START_THETA

SAMPLES = 20_001
# The plant with each option for the normal force.
PLANTS = [replace(NOMINAL, normal_force=option).plant() for option in get_args(NormalForce)]


def torque_without_acceleration(theta: np.ndarray, theta_dot: float, slip: float, p: Plant) -> np.ndarray:
    """Motor torque in N m at theta'' = 0, from Eq. (1); `slip` is +1.0, -1.0 or, for stick, 0.0."""
    ml = p.m * p.l
    sin, cos = np.sin(theta), np.cos(theta)
    at_rest = -ml * p.g * sin + p.k * theta + p.c * theta_dot
    if slip == 0.0:
        return at_rest
    friction = slip * p.mu * np.maximum(0.0, dynamics.normal_force(theta, theta_dot, 0.0, p))
    return at_rest + ml * cos * (ml * sin * theta_dot**2 + friction) / (p.M + p.m)  # Eq. (32)


def _slope_of_torque(largest_theta: float, theta_dot: float, p: Plant) -> float:
    """Bound on |d torque / d theta| of `torque_without_acceleration` in N m/rad, for |theta| <= largest_theta."""
    ml, total = p.m * p.l, p.M + p.m
    pivot = p.k * largest_theta + p.c * abs(theta_dot)
    centrifugal = ml * theta_dot**2
    friction = p.mu * (total * p.g + 2.0 * centrifugal + 2.0 * pivot + p.k)
    return ml * p.g + p.k + ml * (centrifugal + friction) / total


def torque_at_peak(velocity: float, low: float, high: float, slips: tuple[float, ...] = (0.0, 1.0, -1.0)) -> float:
    """A lower bound in N m on the largest torque of every motion whose theta' peaks at a given value (rad/s).

    Theorem. Let theta' > 0 attain its maximum V at an angle in [low, high]. Then the torque is, at or just before the
    peak, at least min over [low, high] and over the contact modes of the torque of Eq. (1) at theta'' = 0, theta' = V.

    Argument. In every mode Eq. (1) gives u = J theta'' + u_0(theta, theta') with J > 0: m l^2 in stick and
    m l^2 (1 - m cos (cos +- mu sin) / (M + m)) in slip, positive where the contact is regular. Where u is continuous,
    theta'' = 0 at the peak and u = u_0. Where u or the mode jumps there, theta' still grew towards its maximum, so
    theta'' >= 0 at times arbitrarily close before it, and there u >= u_0, which is continuous within a mode. The
    torque's friction enters by N at theta'' = 0, so both options for the normal force are searched. The minimum over a
    grid is lowered by the largest slope times half the spacing, which makes it a bound.
    """
    theta = np.linspace(low, high, SAMPLES)
    margin = 0.5 * (high - low) / (SAMPLES - 1)
    return min(
        float(torque_without_acceleration(theta, velocity, slip, p).min())
        - _slope_of_torque(max(abs(low), abs(high)), velocity, p) * margin
        for p in PLANTS
        for slip in slips
    )


def check_torques() -> list[dict[str, Any]]:
    """For both profiles certified lower bounds on the torque at the peak, in any contact and `sticking`, N m.

    The proof holds where the `published` torque is below the `bound`.
    """
    found = []
    for name, numbers in published.RUNS.items():
        velocity, torque, swing = (numbers[key].value for key in ("peak_velocity", "peak_torque", "swing"))
        row: dict[str, Any] = {"name": name, "velocity": velocity, "published": torque}
        row["bound"] = torque_at_peak(velocity, START_THETA, math.radians(swing))
        found.append({**row, "sticking": torque_at_peak(velocity, START_THETA, math.radians(swing), slips=(0.0,))})
    return found
