"""Two proofs that the published torques cannot give the published velocities on the published plant.

Neither knows the reference, the gains or the law: they hold for every motor torque that stays within the limit. Both
are certified: what is sampled is widened by a bound on what happens between the samples. They cover either direction
of slip, stick, and both options for the normal force.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba.extending import register_jitable

from baselines.paper import published
from capsule_gym import dynamics
from capsule_gym.compilation import compile_cached
from capsule_gym.parameters import Capsule, Plant
from capsule_gym.task import START_THETA

SAMPLES = 20_001
# So many that the widening below costs the bound less than 0.01 rad/s.
ENVELOPE_STEPS = 400_000
# Of the envelope itself; its error is then below 1e-3 rad/s.
COARSE_STEPS = 20_000
BISECTIONS = 25
# N m; reaches every published velocity.
STRONGEST = 4.0
# ms; a swing that takes longer has come to rest.
LONGEST_SWING = 2000
# No torque of a few N m makes the pendulum faster, rad/s.
FASTEST = 40.0


@dataclass(frozen=True)
class PeakTorque:
    """Proof 1 for one published pair of velocity and torque.

    Attributes:
        name: of the profile.
        velocity: the published peak velocity, rad/s.
        published: the published largest torque, N m.
        bound: certified lower bound on the torque at the peak, N m.
        angle: where it is smallest, rad.
        mode: the contact there.
        sticking: the same bound for a platform at rest, N m.
        anywhere: the bound over all angles above the platform, |theta| <= pi/2, N m.
    """

    name: str
    velocity: float
    published: float
    bound: float
    angle: float
    mode: str
    sticking: float
    anywhere: float

    @property
    def holds(self) -> bool:
        """Whether the published torque is below what the published velocity takes."""
        return self.published < self.bound


@dataclass(frozen=True)
class Envelope:
    """Proof 2 for one published pair of velocity and torque.

    Attributes:
        name: of the profile.
        torque: the published largest torque, N m.
        published: the published peak velocity, rad/s.
        bound: certified upper bound on theta' under that torque, from rest anywhere in +-swing, rad/s.
        from_start: the same from rest at -60 degrees, rad/s.
        estimate: the peak of that envelope itself, without the margin of certification, rad/s.
        torque_needed: the torque whose envelope from -60 degrees reaches the published velocity: none below does, N m.
        torque_enough: the constant torque that reaches it from -60 degrees, by simulation, N m.
        undamped: what `from_start` would be for c = 0, rad/s.
    """

    name: str
    torque: float
    published: float
    bound: float
    from_start: float
    estimate: float
    torque_needed: float
    torque_enough: float
    undamped: float

    @property
    def holds(self) -> bool:
        """Whether the published velocity is beyond what the published torque reaches."""
        return self.published > self.bound


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
    velocity: float,
    low: float,
    high: float,
    capsule: Capsule | None = None,
    slips: tuple[float, ...] = (0.0, 1.0, -1.0),
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
        capsule: the plant; its option for the normal force does not matter.
        slips: the contact modes to search.

    Returns:
        The bound in N m, the angle in rad where it is attained, and the mode in words.
    """
    capsule = capsule or Capsule()
    theta = np.linspace(low, high, SAMPLES)
    margin = 0.5 * (theta[1] - theta[0])
    best = (math.inf, 0.0, "")
    for option in ("newton", "paper"):
        p = replace(capsule, normal_force=option).plant()
        slope = _slope_of_torque(max(abs(low), abs(high)), velocity, p)
        for slip in slips:
            torque = torque_without_acceleration(theta, velocity, slip, p) - slope * margin
            n = int(torque.argmin())
            mode = "stick" if slip == 0.0 else f"slip {'forwards' if slip > 0.0 else 'backwards'}, N by {option}"
            best = min(best, (float(torque[n]), float(theta[n]), mode))
    return best


@register_jitable
def largest_acceleration(
    theta: float, theta_dot: float, u: float, newton: Plant, paper: Plant, frictionless: Plant
) -> float:
    """The largest theta'' in rad/s^2 of any contact mode and option for the normal force, and without contact."""
    largest = dynamics.accelerations(theta, theta_dot, 0.0, u, newton)[0]
    largest = max(largest, dynamics.accelerations(theta, theta_dot, 1.0, u, frictionless)[0])
    for slip in (1.0, -1.0):
        largest = max(largest, dynamics.accelerations(theta, theta_dot, slip, u, newton)[0])
        largest = max(largest, dynamics.accelerations(theta, theta_dot, slip, u, paper)[0])
    return largest


def integrate_envelope(
    low: float,
    high: float,
    steps: int,
    u: float,
    along_theta: float,
    along_square: float,
    newton: Plant,
    paper: Plant,
    frictionless: Plant,
) -> np.ndarray:
    """theta'^2 of the envelope on steps + 1 angles from low to high: Euler steps that never fall.

    Args:
        low: first angle, rad; the pendulum rests there.
        high: last angle, rad.
        steps: number of steps.
        u: the torque limit, N m.
        along_theta: bound on |d theta'' / d theta|, 1/s^2 per rad; 0 for the envelope itself instead of a bound on it.
        along_square: bound on the increase of theta'' per theta'^2, 1/rad.
        newton: the plant with Newton's normal force.
        paper: with the paper's.
        frictionless: without friction.
    """
    h = (high - low) / steps
    squares = np.zeros(steps + 1)
    for n in range(steps):
        acceleration = largest_acceleration(low + n * h, math.sqrt(squares[n]), u, newton, paper, frictionless)
        # The slope sigma of the step solves sigma = 2 (a + A h + B sigma h), which bounds 2 theta'' on all of it.
        sigma = 2.0 * (acceleration + along_theta * h) / (1.0 - 2.0 * along_square * h)
        squares[n + 1] = squares[n] + h * max(0.0, sigma)
    return squares


@lru_cache(maxsize=1)
def _compiled_envelope() -> Any:
    """The function above, compiled."""
    return compile_cached(integrate_envelope)


def upper_envelope(
    limit: float, low: float, high: float, capsule: Capsule | None = None, *, certified: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Proof 2: the fastest that any torque within +-limit can make the pendulum pass an angle.

    Theorem. Let |u| <= limit, let the motion start at rest in [low, high] and stay there. Then theta' <= E(theta),
    where E solves E dE/dtheta = max over the contact modes of theta''(theta, E, u = limit), E(low) = 0, E never
    falling.

    Argument. Every stretch with theta' > 0 begins at rest at some angle in [low, high], where E >= 0 = theta'. On it
    w = theta'^2 is a function of the angle with dw/dtheta = 2 theta'' <= 2 F(theta, sqrt(w)), F the maximum over the
    modes at the largest torque, since theta'' grows with u in each of them. E^2 satisfies the same relation with >=,
    F grows with w at a bounded rate at most (the damper only lowers it), and so the comparison theorem for scalar
    equations gives w <= E^2.
    A platform that has lost contact moves without friction; that mode is among those searched.

    Each Euler step is widened by bounds on the derivatives of F over the whole step, so that the polygon lies above
    every solution: it is a proof up to rounding, not an approximation.

    Args:
        limit: N m.
        low: smallest angle of the swing, rad.
        high: largest, rad.
        capsule: the plant; its option for the normal force does not matter.
        certified: whether to widen the steps; without it the polygon approximates E itself.

    Returns:
        Angles in rad and E in rad/s there.
    """
    capsule = capsule or Capsule()
    newton, paper = (replace(capsule, normal_force=option).plant() for option in ("newton", "paper"))
    along_theta, along_square = _slopes_of_acceleration(limit, max(abs(low), abs(high)), FASTEST, newton)
    steps = ENVELOPE_STEPS
    if not certified:
        along_theta, along_square, steps = 0.0, 0.0, COARSE_STEPS
    squares = _compiled_envelope()(
        low, high, steps, limit, along_theta, along_square, newton, paper, newton._replace(mu=0.0)
    )
    if squares[-1] > FASTEST**2:
        raise ValueError(f"limit must be small enough for speeds below {FASTEST:g} rad/s, got {limit!r} N m")
    return np.linspace(low, high, steps + 1), np.sqrt(squares)


def _slopes_of_acceleration(limit: float, largest_theta: float, fastest: float, p: Plant) -> tuple[float, float]:
    """Bounds on |d theta''/d theta| (1/s^2 per rad) and on the increase of theta'' per theta'^2 (1/rad).

    theta'' = n / d with d = m l^2 (M + m) - (m l)^2 cos (cos +- mu sin), the pivot's torque bounded by its parts. The
    damper makes theta'' fall with theta' in every mode, so only the centrifugal terms count for the second bound.
    """
    ml, total = p.m * p.l, p.M + p.m
    smallest = ml * p.l * total - ml * ml * (1.0 + p.mu)
    pivot = p.k * largest_theta + p.c * fastest
    centrifugal = ml * fastest**2
    friction = p.mu * (total * p.g + centrifugal + pivot)
    numerator = total * (limit + ml * p.g + pivot) + ml * (centrifugal + friction)
    along = total * (ml * p.g + p.k) + ml * (2.0 * centrifugal + friction + p.mu * (centrifugal + pivot + p.k))
    along_theta = along / smallest + numerator * ml * ml * (1.0 + p.mu) / smallest**2
    return along_theta, ml * ml * (0.5 + p.mu) / smallest


def fastest_swing(
    limit: float, low: float, high: float, capsule: Capsule | None = None, *, certified: bool = True
) -> float:
    """The peak of `upper_envelope` in rad/s."""
    return float(upper_envelope(limit, low, high, capsule, certified=certified)[1][-1])


def torque_to_reach(velocity: float, low: float, high: float, capsule: Capsule | None = None) -> float:
    """The smallest torque limit in N m whose envelope from rest at `low` reaches a velocity (rad/s) before `high`."""
    return _least(lambda torque: fastest_swing(torque, low, high, capsule, certified=False) >= velocity)


def constant_torque_to_reach(velocity: float, low: float, high: float, capsule: Capsule | None = None) -> float:
    """The constant torque in N m that takes the capsule from rest at `low` to a velocity (rad/s) before `high`."""
    p = (capsule or Capsule()).plant()

    def reaches(torque: float) -> bool:
        theta, theta_dot, x, x_dot = low, 0.0, 0.0, 0.0
        for _ in range(LONGEST_SWING):
            motion = dynamics.step(theta, theta_dot, x, x_dot, torque, p, 1e-3)
            theta, theta_dot, x, x_dot = motion[:4]
            if theta_dot >= velocity or theta_dot <= 0.0 or theta >= high:
                break
        return theta_dot >= velocity

    return _least(reaches)


def _least(enough: Callable[[float], bool]) -> float:
    """The smallest torque in N m that is enough, by bisection."""
    weak, strong = 0.0, STRONGEST
    for _ in range(BISECTIONS):
        middle = 0.5 * (weak + strong)
        weak, strong = (weak, middle) if enough(middle) else (middle, strong)
    return strong


def peak_torques() -> list[PeakTorque]:
    """Proof 1 for the proposed profile and for EPC."""
    found = []
    for name, numbers in (("proposed", published.PROPOSED), ("EPC", published.EPC)):
        velocity, high = numbers["peak_velocity"].value, math.radians(numbers["swing"].value)
        bound, angle, mode = torque_at_peak(velocity, START_THETA, high)
        sticking, _, _ = torque_at_peak(velocity, START_THETA, high, slips=(0.0,))
        anywhere, _, _ = torque_at_peak(velocity, -math.pi / 2.0, math.pi / 2.0)
        found.append(PeakTorque(name, velocity, numbers["peak_torque"].value, bound, angle, mode, sticking, anywhere))
    return found


def envelopes() -> list[Envelope]:
    """Proof 2 for the proposed profile and for EPC."""
    found = []
    for name, numbers in (("proposed", published.PROPOSED), ("EPC", published.EPC)):
        velocity, limit = numbers["peak_velocity"].value, numbers["peak_torque"].value
        largest = math.radians(numbers["swing"].value)
        swing = (START_THETA, largest)
        found.append(
            Envelope(
                name,
                limit,
                velocity,
                bound=fastest_swing(limit, -largest, largest),
                from_start=fastest_swing(limit, *swing),
                estimate=fastest_swing(limit, *swing, certified=False),
                torque_needed=torque_to_reach(velocity, *swing),
                torque_enough=constant_torque_to_reach(velocity, *swing),
                undamped=fastest_swing(limit, *swing, Capsule(c=0.0)),
            )
        )
    return found
