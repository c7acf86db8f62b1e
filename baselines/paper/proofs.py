"""Two proofs that the published torques cannot give the published velocities on the published plant.

Neither depends on the reference, the gains or the law: they hold for every motor torque that stays within the limit.
Both are certified: sampled quantities are widened by a bound on their change between the samples. They cover either
direction of slip, stick, and both options for the normal force. They bound the torque against the rate, not the mean
speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, get_args

import numpy as np

from baselines.paper import published
from capsule_gym import dynamics
from capsule_gym.parameters import Capsule, NormalForce, Plant
from capsule_gym.task import START_THETA

SAMPLES = 20_001
BISECTIONS = 22
STRONGEST = 4.0  # N m; reaches every published velocity
LONGEST_SWING = 2000  # ms; a swing that takes longer has come to rest
# Steps of an envelope: the widening changes the bounds on the published swings by less than 1e-3 rad/s.
STEPS = 100_000
COARSE_STEPS = 10_000  # of the first estimate of the peak
WINDOW = 2000  # steps of an envelope that are iterated together
# Factor on that estimate up to which the slopes of the widening are valid, and number of attempts with its powers.
HEADROOM, ATTEMPTS = 1.05, 12


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
    """Proof 1: a lower bound in N m on the largest torque of every motion whose theta' peaks at a given value (rad/s).

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
        for p in _both_contacts(Capsule())
        for slip in slips
    )


class Envelope(NamedTuple):
    """The largest rate (rad/s) of the pendulum at evenly spaced angles (rad), for rates > 0; mirrored for rates < 0.

    It never falls, and no rate between two angles exceeds the latter's.
    """

    theta: np.ndarray
    theta_dot: np.ndarray

    @property
    def fastest(self) -> float:
        """The largest rate of all, rad/s."""
        return float(self.theta_dot[-1])


def largest_acceleration(theta: np.ndarray, theta_dot: np.ndarray, u: float, plants: Sequence[Plant]) -> np.ndarray:
    """The largest theta'' in rad/s^2 in stick, without contact, and in slip either way on any of the plants."""
    # Rows: stick; slip without friction, as without contact; slip either way.
    slip = np.array([[0.0], [1.0], [1.0], [-1.0]])
    found = []
    for p in plants:
        friction: Any = np.array([[0.0], [0.0], [p.mu], [p.mu]])
        found.append(dynamics.accelerations(theta, theta_dot, 0.0, slip, u, p._replace(mu=friction)).theta_ddot)
    return np.concatenate(found).max(axis=0)


def integrate_envelope(
    low: float, high: float, steps: int, u: float, along_theta: float, along_square: float, plants: Sequence[Plant]
) -> np.ndarray:
    """theta'^2 of the envelope on steps + 1 angles from low to high: Euler steps that never fall.

    All steps of a window are computed from the squares of the previous iteration, until no square changes: these are
    the squares of one step after the other. `u` is the torque limit in N m; `along_theta` and `along_square` bound
    |d theta'' / d theta| (1/s^2 per rad, 0 for an estimate) and the increase of theta'' per theta'^2 (1/rad). The
    plants have the largest friction coefficient in both directions.
    """
    h = (high - low) / steps
    theta, squares = low + np.arange(steps) * h, np.zeros(steps + 1)
    for first in range(0, steps, WINDOW):
        window = slice(first, min(first + WINDOW, steps))
        own = squares[first : window.stop + 1]
        own[1:] = own[0]
        while True:
            acceleration = largest_acceleration(theta[window], np.sqrt(own[:-1]), u, plants)
            # The slope sigma of the step solves sigma = 2 (a + A h + B sigma h), which bounds 2 theta'' on all of it.
            sigma = 2.0 * (acceleration + along_theta * h) / (1.0 - 2.0 * along_square * h)
            found = np.cumsum(np.concatenate([own[:1], h * np.maximum(0.0, sigma)]))
            if np.array_equal(found, own):
                break
            own[:] = found
    return squares


def upper_envelope(limit: float, low: float, high: float, *plants: Plant) -> Envelope:
    """The largest rate that any torque within +-limit (N m) can give the pendulum at each angle of a swing, in rad.

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
    friction that differs by direction, and for its mirror image (theta, u -> -theta, -u) where theta' < 0. Each Euler
    step is widened by bounds on the derivatives of F over the whole step: the polygon lies above every solution.

    Several plants, which differ in the option for the normal force alone, share one envelope.

    Raises:
        ValueError: if the damper could accelerate the pendulum through the paper's normal force, or the steps are too
            wide for such a torque.
    """
    rough = tuple(p._replace(mu=p.mu * max(1.0, p.backward_ratio), backward_ratio=1.0) for p in plants)
    theta = np.linspace(low, high, STEPS + 1)
    squares = integrate_envelope(low, high, COARSE_STEPS, limit, 0.0, 0.0, rough)
    largest, h = max(abs(low), abs(high)), (high - low) / STEPS
    fastest = HEADROOM * math.sqrt(squares[-1])
    for _ in range(ATTEMPTS):
        slopes = [_slopes_of_acceleration(limit, largest, fastest, p) for p in rough]
        along_theta, along_square = (max(column) for column in zip(*slopes, strict=True))
        if 4.0 * along_square * h < 1.0:
            squares = integrate_envelope(low, high, STEPS, limit, along_theta, along_square, rough)
            # The slopes hold up to this rate only.
            if squares[-1] <= fastest**2:
                return Envelope(theta, np.sqrt(squares))
        fastest *= HEADROOM
    raise ValueError(f"limit must be small enough for {STEPS} steps from {low:g} to {high:g} rad, got {limit!r} N m")


def _slopes_of_acceleration(limit: float, largest_theta: float, fastest: float, p: Plant) -> tuple[float, float]:
    """Bounds on |d theta''/d theta| (1/s^2 per rad) and on the increase of theta'' per theta'^2 (1/rad).

    theta'' = n / d with d = m l^2 (M + m) - (m l)^2 cos (cos +- mu sin), the pivot's torque bounded by its parts. The
    damper makes theta'' fall with theta' in every mode, so only the centrifugal terms count for the second bound. With
    the paper's normal force this requires M + m > mu m l / 2.
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


def swing_envelope(limit: float, low: float, high: float, capsule: Capsule | None = None) -> Envelope:
    """Proof 2: the envelope of a swing from rest, for both options of the normal force; see `upper_envelope`."""
    return upper_envelope(limit, low, high, *_both_contacts(capsule or Capsule()))


def _both_contacts(capsule: Capsule) -> list[Plant]:
    """A capsule with each option for the normal force."""
    return [replace(capsule, normal_force=option).plant() for option in get_args(NormalForce)]


def bisect(below: Callable[[float], bool]) -> tuple[float, float]:
    """Two torques up to `STRONGEST` between which a condition changes: it holds at the first and not at the second."""
    low, high = 0.0, STRONGEST
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return low, high


def torque_needed(velocity: float, low: float, high: float) -> float:
    """The largest torque limit in N m whose envelope from rest at `low` stays below a velocity (rad/s) up to `high`."""
    return bisect(lambda torque: swing_envelope(torque, low, high).fastest < velocity)[0]


def torque_enough(velocity: float, low: float, high: float) -> float:
    """A constant torque in N m that takes the capsule from rest at `low` to a velocity (rad/s) before `high`."""
    p = Capsule().plant()

    def fails(torque: float) -> bool:
        state: tuple[Any, Any, Any, Any] = (low, 0.0, 0.0, 0.0)
        for _ in range(LONGEST_SWING):
            state = dynamics.step(*state, torque, p, 1e-3)[:4]
            theta, theta_dot = float(state[0]), float(state[1])
            if theta_dot >= velocity or theta_dot <= 0.0 or theta >= high:
                break
        return theta_dot < velocity

    return bisect(fails)[1]


def _published(name: str) -> tuple[float, float, float]:
    """The published peak velocity (rad/s), largest torque (N m) and largest angle (rad) of a profile."""
    numbers = published.RUNS[name]
    return numbers["peak_velocity"].value, numbers["peak_torque"].value, math.radians(numbers["swing"].value)


def check_proof_1() -> list[dict[str, Any]]:
    """Proof 1 for both profiles: certified lower bounds on the torque at the peak, in any contact and `sticking`, N m.

    It holds where the `published` torque is below the `bound`.
    """
    found = []
    for name in published.RUNS:
        velocity, torque, largest = _published(name)
        row: dict[str, Any] = {"name": name, "velocity": velocity, "published": torque}
        row["bound"] = torque_at_peak(velocity, START_THETA, largest)
        found.append({**row, "sticking": torque_at_peak(velocity, START_THETA, largest, slips=(0.0,))})
    return found


def check_proof_2() -> list[dict[str, Any]]:
    """Proof 2 for both profiles. It holds where the `published` velocity (rad/s) is above the `bound`.

    Returns:
        By profile: the published `torque` (N m); the certified upper bound on theta' under it from rest anywhere in
        +-swing (`bound`, rad/s), from rest at -60 degrees (`from_start`) and from there without the damper
        (`undamped`); the certified lower bound on the torque that reaches the published velocity from -60 degrees
        (`torque_needed`, N m) and a constant torque that does, by simulation (`torque_enough`).
    """
    found = []
    for name in published.RUNS:
        velocity, limit, largest = _published(name)
        swing = (START_THETA, largest)
        row: dict[str, Any] = {"name": name, "torque": limit, "published": velocity}
        row["bound"] = swing_envelope(limit, -largest, largest).fastest
        row["from_start"] = swing_envelope(limit, *swing).fastest
        row["torque_needed"] = torque_needed(velocity, *swing)
        row["torque_enough"] = torque_enough(velocity, *swing)
        found.append({**row, "undamped": swing_envelope(limit, *swing, Capsule(c=0.0)).fastest})
    return found
