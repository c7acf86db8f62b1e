"""What a profile is worth when the pendulum follows it exactly: speed, torque and energy, without any control law.

The platform's motion follows from the second row of Eq. (1) and the torque from the first. The demands are Principles 1
to 4 and a torque limit; each becomes a share, load over limit, and holds up to 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba.extending import register_jitable

from baselines.laws.profiles import PROPOSED, Profile
from baselines.laws.reference import platform_motion
from baselines.paper.principles import sample
from capsule_gym import dynamics
from capsule_gym.compilation import compile_cached
from capsule_gym.parameters import Plant, check_number

# Without Principle 1 the ball's meeting the platform still bounds the angle, rad.
BALL_AT_PLATFORM = math.pi / 2.0
# Speed in m/s that counts as a whole violation where the platform is to be at rest.
SPEED_SCALE = 0.1
# Sums of the sampled angles are exact to a few units of the last place only.
ROUNDING = 1e-9

# Lets the compiled function below call it.
register_jitable(platform_motion)


@dataclass(frozen=True)
class Standstill:
    """A reading of Principle 4. Phases are numbered from 1, and every demand reaches to the end of the cycle.

    Attributes:
        force_from: first phase in which the force on a platform at rest must stay below static friction, Eq. (8).
        rest_from: first phase in which the platform must be at rest.
        printed: take both sides of (8) as printed instead of Newton's.
    """

    force_from: int
    rest_from: int
    printed: bool = False


STANDSTILLS = {
    # What the published profile itself keeps: the force is small enough from phase V on, but the platform enters phase
    # V with 1.1 cm/s backwards and comes to rest within it.
    "return": Standstill(5, 6),
    # At rest as soon as the pendulum turns back.
    "strict-return": Standstill(5, 5),
    # Definition 4 in full: the restoring stage begins with phase IV.
    "restoring": Standstill(4, 4),
    # (8) as printed, in the restoring stage.
    "printed": Standstill(4, 6, printed=True),
}
_NO_PHASE = Standstill(99, 99)


@dataclass(frozen=True)
class Demands:
    """What is asked of a profile; None leaves a principle out.

    Attributes:
        torque: the largest torque, N m.
        theta_0: Principle 1, rad.
        v_theta: Principle 2, rad/s.
        a_theta: Principle 2, rad/s^2.
        contact: Principle 3, the floor carries the platform throughout.
        standstill: Principle 4.

    Raises:
        TypeError: if a bound is no number.
        ValueError: if a bound is not positive.
    """

    torque: float
    theta_0: float | None = None
    v_theta: float | None = None
    a_theta: float | None = None
    contact: bool = True
    standstill: Standstill | None = STANDSTILLS["return"]

    def __post_init__(self) -> None:
        for name in ("torque", "theta_0", "v_theta", "a_theta"):
            value = getattr(self, name)
            if value is not None or name == "torque":
                check_number(f"Demands.{name}", value, "a finite number > 0", 0.0, open_low=True)


@lru_cache(maxsize=1)
def published_bounds() -> tuple[float, float, float]:
    """theta_0 (rad), v_theta (rad/s) and a_theta (rad/s^2): what the published profile itself needs."""
    cycle = sample(PROPOSED)
    largest = (np.abs(values).max() for values in (cycle.theta, cycle.theta_dot, cycle.theta_ddot))
    theta_0, v_theta, a_theta = (float(value) for value in largest)
    return theta_0, v_theta, a_theta


@dataclass(frozen=True)
class Assessment:
    """A profile on one or several plants; of several, the worst value of each.

    Attributes:
        mean_speed: from rest, over the cycle, or over five where the platform does not end the first one at rest, m/s.
        cost_of_transport: integral of |u theta'| over (M + m) g and distance; infinite where it gets nowhere.
        peak_torque: N m.
        backward_ratio: distance backwards over forwards; infinite where it only moves backwards.
        shares: load over limit by demand. 1 is reached, more is violated.
    """

    mean_speed: float
    cost_of_transport: float
    peak_torque: float
    backward_ratio: float
    shares: dict[str, float]

    @property
    def excess(self) -> float:
        """The sum of all violations; 0.0 where every demand is met."""
        return sum(share - 1.0 for share in self.shares.values() if share > 1.0 + ROUNDING)

    @property
    def feasible(self) -> bool:
        """Whether every demand is met."""
        return self.excess == 0.0


@register_jitable
def _sample(segments: np.ndarray, start: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """A profile in the middle of every step, and at both ends of every phase.

    Args:
        segments: the fields of its `Segment`s, shape (phases, 6).
        start: angle at the start, rad.
        h: length of a step, s, of which every phase lasts a multiple.

    Returns:
        Shapes (4, steps) and (4, 2 phases), rows theta, theta', theta'' and the number of the phase from 0.
    """
    total = 0
    for n in range(len(segments)):
        total += round(segments[n, 0] / h)
    steps, ends = np.empty((4, total)), np.empty((4, 2 * len(segments)))
    first = 0
    reached = start
    for n in range(len(segments)):
        duration, amplitude, phase, rate, offset, slope = segments[n]
        count = round(duration / h)
        for j in range(-2, count):
            # The ends of the phase, then its steps.
            s = 0.0 if j == -2 else duration if j == -1 else (j + 0.5) * h
            out, column = (ends, 2 * n + j + 2) if j < 0 else (steps, first + j)
            arc = math.cos(phase) - math.cos(phase + rate * s)
            out[0, column] = reached + amplitude / rate * arc + (offset + 0.5 * slope * s) * s
            out[1, column] = amplitude * math.sin(phase + rate * s) + offset + slope * s
            out[2, column] = amplitude * rate * math.cos(phase + rate * s) + slope
            out[3, column] = n
        first += count
        reached = ends[0, 2 * n + 1]
    return steps, ends


@register_jitable
def _demand_shares(samples: np.ndarray, force_from: float, contact: Plant, p: Plant) -> tuple[float, ...]:
    """The largest |theta|, |theta'|, |theta''|, lift over weight (7), and force over static friction (8)."""
    angle = speed = acceleration = lift = share = 0.0
    for n in range(samples.shape[1]):
        theta, theta_dot, theta_ddot = samples[0, n], samples[1, n], samples[2, n]
        angle = max(angle, abs(theta))
        speed = max(speed, abs(theta_dot))
        acceleration = max(acceleration, abs(theta_ddot))
        normal = dynamics.normal_force(theta, theta_dot, theta_ddot, p)
        lift = max(lift, 1.0 - normal / ((p.M + p.m) * p.g))
        if samples[3, n] >= force_from:
            pivot = contact.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * math.cos(theta)
            force = dynamics.driving_force(theta, theta_dot, theta_ddot, p) + pivot
            normal = max(0.0, dynamics.normal_force(theta, theta_dot, theta_ddot, contact))
            limit = p.static_ratio * dynamics.kinetic_friction(force, p) * normal
            share = max(share, abs(force) / limit if limit > 0.0 else math.inf)
    return angle, speed, acceleration, lift, share


def measure(
    segments: np.ndarray, start: float, h: float, force_from: float, rest_time: float, contact: Plant, p: Plant
) -> tuple[float, ...]:
    """Follows cycles of a profile from rest: one where the platform ends it at rest, else five as the paper does.

    Args:
        segments: the fields of the profile's `Segment`s, shape (phases, 6).
        start: angle at the start, rad.
        h: length of a step, s, of which every phase lasts a multiple.
        force_from: phase, from 0, from which on Principle 4 bounds the force.
        rest_time: time in the cycle from which on the platform is to be at rest, s.
        contact: the plant with the normal force of Principle 4.
        p: the plant that moves.

    Returns:
        Distance and distance backwards (m), duration (s), largest torque (N m), integral of |u theta'| (J), the
        largest speed where there should be none (m/s), and the five values of `_demand_shares`.
    """
    steps, ends = _sample(segments, start, h)
    shares = _demand_shares(np.concatenate((steps, ends), axis=1), force_from, contact, p)
    count = steps.shape[1]
    motion = platform_motion(steps[0], steps[1], steps[2], h, p)
    if motion[1, -1] + h * motion[2, -1] != 0.0:
        steps = np.concatenate((steps, steps, steps, steps, steps), axis=1)
        motion = platform_motion(steps[0], steps[1], steps[2], h, p)
    ml = p.m * p.l
    backward = peak = energy = restless = 0.0
    for n in range(steps.shape[1]):
        theta, theta_dot = steps[0, n], steps[1, n]
        inertia = ml * (p.l * steps[2, n] - math.cos(theta) * motion[2, n])
        u = inertia - ml * p.g * math.sin(theta) + p.k * theta + p.c * theta_dot  # Eq. (1), first row
        peak = max(peak, abs(u))
        energy += h * abs(u * theta_dot)
        if n > 0:
            backward += max(0.0, motion[0, n - 1] - motion[0, n])
        if (n % count + 0.5) * h >= rest_time:
            restless = max(restless, abs(motion[1, n]))
    return (motion[0, -1], backward, h * steps.shape[1], peak, energy, restless, *shares)


@lru_cache(maxsize=1)
def _measure() -> Any:
    """The function above, compiled."""
    return compile_cached(measure)


def assess(
    profile: Profile, demands: Demands, plants: Sequence[Plant], h: float = 1e-4, early: float = 0.0
) -> Assessment:
    """Judges a profile under exact tracking, on the worst of some plants for each demand.

    Args:
        profile: the profile.
        demands: what is asked of it.
        plants: the plants.
        h: step of the platform's motion, s, of which every phase lasts a multiple.
        early: how much earlier than Principle 4 asks the platform must be at rest, s.

    Raises:
        ValueError: if there is no plant, or the phases are no multiples of h.
    """
    if not plants:
        raise ValueError("plants must hold at least one plant, got none")
    segments = np.array([astuple(segment) for segment in profile.segments])
    if np.abs(np.rint(segments[:, 0] / h) * h - segments[:, 0]).max() > 1e-9:
        raise ValueError(f"h must divide the phases of the profile, got {h!r} s for {segments[:, 0].tolist()} s")
    stand = demands.standstill or _NO_PHASE
    rest_time = math.inf
    if stand.rest_from <= len(segments):
        rest_time = float(profile.times[stand.rest_from - 2]) - early
    rows = []
    for p in plants:
        contact = p._replace(pivot_torque_on_contact=1.0) if stand.printed else p
        row = _measure()(segments, profile.start, h, stand.force_from - 1.0, rest_time, contact, p)
        distance, backward, duration, energy = row[0], row[1], row[2], row[4]
        cost = energy / ((p.M + p.m) * p.g * distance) if distance > 0.0 else math.inf
        forward = distance + backward
        back = backward / forward if forward > 0.0 else math.inf if backward > 0.0 else 0.0
        rows.append((-distance / duration, cost, back, row[3], *row[5:]))
    worst = [max(column) for column in zip(*rows, strict=True)]
    minus_speed, cost, back, peak, restless, angle, speed, acceleration, lift, force = worst
    shares = {"torque": peak / demands.torque, "principle_1": angle / (demands.theta_0 or BALL_AT_PLATFORM)}
    if demands.v_theta is not None:
        shares["principle_2_velocity"] = speed / demands.v_theta
    if demands.a_theta is not None:
        shares["principle_2_acceleration"] = acceleration / demands.a_theta
    if demands.contact:
        shares["principle_3"] = lift
    if demands.standstill is not None:
        shares["principle_4_force"] = force
        shares["principle_4_rest"] = 1.0 + restless / SPEED_SCALE if restless > 0.0 else 0.0
    return Assessment(-minus_speed, cost, peak, back, shares)
