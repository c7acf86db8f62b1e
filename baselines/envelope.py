"""The upper envelope in the phase plane: the fastest that any bounded torque lets the pendulum pass an angle.

It depends on no reference, law or gait, only on the plant and the largest torque. `baselines.paper.proofs` compares the
published torques with it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from capsule_gym import dynamics
from capsule_gym.compilation import jitable
from capsule_gym.compiler import compile_cached
from capsule_gym.parameters import Plant

# So many that the widening below costs the bounds on the published swings less than 1e-3 rad/s.
STEPS = 100_000
# Of the first estimate of the peak.
COARSE_STEPS = 10_000
# Room above that estimate for which the slopes of the widening are valid; more where it proves too little.
HEADROOM = 1.05
ATTEMPTS = 12


class Envelope(NamedTuple):
    """The largest rate of the pendulum at every angle, for rates > 0; the mirror image serves rates < 0.

    Attributes:
        theta: evenly spaced angles, rad.
        theta_dot: the largest rate there, rad/s; it never falls, and no rate between two angles exceeds the latter's.
    """

    theta: np.ndarray
    theta_dot: np.ndarray

    @property
    def fastest(self) -> float:
        """The largest rate of all, rad/s."""
        return float(self.theta_dot[-1])


@jitable
def largest_acceleration(
    theta: float, theta_dot: float, u: float, plants: tuple[Plant, ...], frictionless: Plant
) -> float:
    """The largest theta'' in rad/s^2 in stick, without contact, and in slip either way on any of the plants."""
    largest = dynamics.accelerations(theta, theta_dot, 0.0, 0.0, u, frictionless)[0]
    largest = max(largest, dynamics.accelerations(theta, theta_dot, 0.0, 1.0, u, frictionless)[0])
    for p in plants:
        for slip in (1.0, -1.0):
            largest = max(largest, dynamics.accelerations(theta, theta_dot, 0.0, slip, u, p)[0])
    return largest


def integrate_envelope(
    low: float,
    high: float,
    steps: int,
    u: float,
    along_theta: float,
    along_square: float,
    plants: tuple[Plant, ...],
    frictionless: Plant,
) -> np.ndarray:
    """theta'^2 of the envelope on steps + 1 angles from low to high: Euler steps that never fall.

    Args:
        low: first angle, rad; the pendulum rests there.
        high: last angle, rad.
        steps: number of steps.
        u: the torque limit, N m.
        along_theta: bound on |d theta'' / d theta|, 1/s^2 per rad; 0 for an estimate.
        along_square: bound on the increase of theta'' per theta'^2, 1/rad.
        plants: with the largest friction coefficient both ways.
        frictionless: without friction.
    """
    h = (high - low) / steps
    squares = np.zeros(steps + 1)
    for n in range(steps):
        acceleration = largest_acceleration(low + n * h, math.sqrt(squares[n]), u, plants, frictionless)
        # The slope sigma of the step solves sigma = 2 (a + A h + B sigma h), which bounds 2 theta'' on all of it.
        sigma = 2.0 * (acceleration + along_theta * h) / (1.0 - 2.0 * along_square * h)
        squares[n + 1] = squares[n] + h * max(0.0, sigma)
    return squares


def upper_envelope(limit: float, low: float, high: float, *plants: Plant) -> Envelope:
    """The fastest that any torque within +-limit can make the pendulum pass an angle.

    Theorem. Let |u| <= limit, let the motion start at rest in [low, high] and stay there. Then theta' <= E(theta),
    where E solves E dE/dtheta = max over the contact modes of theta''(theta, E, u = limit), E(low) = 0, E never
    falling.

    Argument. Every stretch with theta' > 0 begins at rest at some angle in [low, high], where E >= 0 = theta'. On it
    w = theta'^2 is a function of the angle with dw/dtheta = 2 theta'' <= 2 F(theta, sqrt(w)), F the maximum over the
    modes at the largest torque, since theta'' grows with u in each of them: the determinant of the slip equations is
    positive where Painleve's paradox is excluded. E^2 satisfies the same relation with >=, F grows with w at a bounded
    rate at most (the damper only lowers it), and so the comparison theorem for scalar equations gives w <= E^2.

    The modes are stick, slip in either direction, and a platform that has lost contact and moves without friction. In
    slip theta'' is a ratio of two linear functions of the friction coefficient, so that its largest value over all
    coefficients from 0 to the largest one lies at an end, and both ends are searched. The envelope therefore holds for
    friction that differs by direction, and for its mirror image (theta, u -> -theta, -u) where theta' < 0.

    Each Euler step is widened by bounds on the derivatives of F over the whole step, so that the polygon lies above
    every solution: it is a proof up to rounding, not an approximation.

    Args:
        limit: > 0, N m.
        low: smallest angle of the swing, rad.
        high: largest, rad.
        plants: one plant, or several that differ in the option for the normal force alone: the envelope covers all.

    Raises:
        ValueError: if the damper could accelerate the pendulum through the paper's normal force, or the steps are too
            wide for such a torque.
    """
    rough = tuple(p._replace(mu=p.mu * max(1.0, p.backward_ratio), backward_ratio=1.0) for p in plants)
    frictionless = rough[0]._replace(mu=0.0)
    theta, integrate = np.linspace(low, high, STEPS + 1), compile_cached(integrate_envelope)
    squares = integrate(low, high, COARSE_STEPS, limit, 0.0, 0.0, rough, frictionless)
    largest, h = max(abs(low), abs(high)), (high - low) / STEPS
    fastest = HEADROOM * math.sqrt(squares[-1])
    for _ in range(ATTEMPTS):
        slopes = [_slopes_of_acceleration(limit, largest, fastest, p) for p in rough]
        along_theta, along_square = (max(column) for column in zip(*slopes, strict=True))
        if 4.0 * along_square * h < 1.0:
            squares = integrate(low, high, STEPS, limit, along_theta, along_square, rough, frictionless)
            # The slopes hold up to this rate only.
            if squares[-1] <= fastest**2:
                return Envelope(theta, np.sqrt(squares))
        fastest *= HEADROOM
    raise ValueError(f"limit must be small enough for {STEPS} steps from {low:g} to {high:g} rad, got {limit!r} N m")


def _slopes_of_acceleration(limit: float, largest_theta: float, fastest: float, p: Plant) -> tuple[float, float]:
    """Bounds on |d theta''/d theta| (1/s^2 per rad) and on the increase of theta'' per theta'^2 (1/rad).

    theta'' = n / d with d = m l^2 (M + m) - (m l)^2 cos (cos +- mu sin), the pivot's torque bounded by its parts. The
    damper makes theta'' fall with theta' in every mode, so only the centrifugal terms count for the second bound. With
    the paper's normal force that takes M + m > mu m l / 2.
    """
    ml, total = p.m * p.l, p.M + p.m
    if p.pivot_torque_on_contact * p.mu * ml >= 2.0 * total:
        raise ValueError(f"plants with the paper's normal force must have mu m l < 2 (M + m), got {p}")
    smallest = ml * p.l * total - 0.5 * ml * ml * (1.0 + math.sqrt(1.0 + p.mu * p.mu))
    pivot = p.k * largest_theta + p.c * fastest
    on_contact = p.pivot_torque_on_contact * pivot
    centrifugal = ml * fastest**2
    friction = p.mu * (total * p.g + centrifugal + on_contact)
    numerator = total * (limit + ml * p.g + pivot) + ml * (centrifugal + friction)
    along = total * (ml * p.g + p.k) + ml * (2.0 * centrifugal + friction)
    along += ml * p.mu * (centrifugal + on_contact + p.pivot_torque_on_contact * p.k)
    along_theta = along / smallest + numerator * ml * ml * (1.0 + p.mu) / smallest**2
    return along_theta, ml * ml * (0.5 + p.mu) / smallest
