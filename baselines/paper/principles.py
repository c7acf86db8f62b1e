"""Principles 3 and 4 (Eqs. 7 and 8) and Lemmas 1 and 2 of the paper, and a proof about its torques.

A principle or lemma is evaluated as load and limit over a cycle of a profile, or over samples of
any motion: it is met where the load does not exceed the limit. Cycles are sampled phase by phase
with both ends, so that the acceleration's jumps count from either side.

A plant with the paper's normal force has the contact of (7) and (8) as printed: they add the torque
of spring and damper, k theta + c theta', to forces. That torque acts between pendulum and platform,
never on the floor, and its dimension is N m.

The proof is that the published torques cannot give the published velocities on the published plant.
It does not depend on the reference, the gains or the law: it holds for every motor torque that
stays within the limit. It is certified: sampled quantities are widened by a bound on their change
between the samples. It covers either direction of slip, stick, and both options for the normal
force. It bounds the torque against the rate, not the mean speed.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from baselines.paper import published
from capsule_gym import dynamics
from capsule_gym.control.laws.profiles import EPC, PROPOSED, Profile
from capsule_gym.parameters import NOMINAL, Capsule, Plant
from capsule_gym.tasks.task import START_THETA

SAMPLES_PER_PHASE = 2001
SAMPLES = 20_001  # of the angle in the proof
SLIPS = (0.0, 1.0, -1.0)  # stick, and both directions of slip
THETA_0 = math.pi / 3.0  # the boundary condition of Sect. 3.2, rad
# Definition 4: the restoring stage. In the profile (9) these are phases IV to VII, in EPC's its
# last four.
RESTORING_PHASES = 4
NEWTON = NOMINAL.plant()
PAPER = Capsule(normal_force="paper").plant()
# Largest |theta'| (rad/s) and |theta''| (rad/s^2) of the random states: beyond the profiles for
# Lemma 1, which is about loss of contact, and around rest for Lemma 2, whose limit is 1.5 rad/s^2.
FAST = (20.0, 400.0)
SLOW = (1.3, 20.0)


@dataclass(frozen=True)
class Cycle:
    """The samples of a motion, in SI units, with the number of their phase from 0.

    Where two phases meet, both have a sample.
    """

    t: np.ndarray
    phase: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray

    @property
    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """theta, theta' and theta''."""
        return self.theta, self.theta_dot, self.theta_ddot


class Demand(NamedTuple):
    """A principle or lemma over a motion: the bounded quantity and its bound at every sample."""

    load: np.ndarray
    limit: np.ndarray | float

    @property
    def ratio(self) -> np.ndarray:
        """Load over limit; infinite where the limit is not positive and therefore never met."""
        limit = np.broadcast_to(self.limit, self.load.shape)
        ratio = np.full_like(self.load, math.inf)
        return np.divide(self.load, limit, out=ratio, where=limit > 0.0)


def sample(profile: Profile, samples: int = SAMPLES_PER_PHASE) -> Cycle:
    """Samples each phase of a cycle of the profile, both of its ends included."""
    phase = np.repeat(np.arange(len(profile.segments)), samples)
    durations = [segment.duration for segment in profile.segments]
    s = np.concatenate([np.linspace(0.0, duration, samples) for duration in durations])
    starts = np.append(0.0, profile.times)
    motion = profile.evaluate_phases(phase, s)
    return Cycle(starts[phase] + s, phase, *motion)


def principle_3(cycle: Cycle, p: Plant) -> Demand:
    """Eq. (7): the platform keeps contact with the floor.

    Load: the pendulum's lift, N; limit: the weight, N.
    """
    weight = (p.M + p.m) * p.g
    return Demand(weight - dynamics.normal_force(*cycle.motion, p), weight)


def principle_4(cycle: Cycle, p: Plant) -> Demand:
    """Eq. (8): a platform at rest stays at rest.

    Load: the pendulum's force, N; limit: the static friction, N. The principle applies to the
    restoring stage, the last `RESTORING_PHASES`. In the phases before, a violation is what moves
    the capsule.
    """
    pivot_force = _pivot_torque(cycle, p) * np.cos(cycle.theta)
    force = dynamics.driving_force(*cycle.motion, p) + pivot_force
    direction_ratio = np.where(force < 0.0, p.backward_ratio, 1.0)
    mu = p.mu * p.static_ratio * direction_ratio
    normal_force = dynamics.normal_force(*cycle.motion, p)
    return Demand(np.abs(force), mu * normal_force)


def lemma_1(cycle: Cycle, p: Plant, *, sufficient: bool = False) -> Demand:
    """Lemma 1, Eq. (10), which the paper presents as sufficient for Principle 3.

    `sufficient` gives its premise (12). With a = m l theta'' + k theta + c theta' and
    b = m l theta'^2, (12), sqrt(a^2 + b^2) < (M + m) g, is sufficient by Cauchy and Schwarz. (10)
    follows from (12) and is sufficient for nothing: at theta = 0 with a = 0 it holds at every
    speed. Nor is it necessary for (7), in which a drops out at theta = 0.
    """
    ml = p.m * p.l
    weight = (p.M + p.m) * p.g
    a = ml * cycle.theta_ddot + _pivot_torque(cycle, p)
    if sufficient:
        return Demand(np.hypot(a, ml * cycle.theta_dot**2), weight)  # Eq. (12)
    load = cycle.theta_dot**2 * np.abs(a)
    return Demand(load, weight**2 / (2.0 * ml))  # Eq. (10)


def lemma_2(cycle: Cycle, p: Plant, *, sufficient: bool = False) -> Demand:
    """Lemma 2, Eq. (15), which the paper presents as sufficient for Principle 4.

    As printed a strong deceleration meets it, and the terms of spring and damper lack 1 / (m l).
    `sufficient` gives the corrected form, which is sufficient for (8) by Cauchy and Schwarz:

        |theta'' + (k theta + c theta') / (m l)| + theta'^2 <= (M + m) g / (m l) mu / sqrt(mu^2 + 1)

    Friction is that of a plant with one coefficient.
    """
    torque = _pivot_torque(cycle, p)
    if sufficient:
        acceleration = cycle.theta_ddot + torque / (p.m * p.l)
        load = np.abs(acceleration) + cycle.theta_dot**2
    else:
        load = cycle.theta_ddot + cycle.theta_dot**2 + torque  # Eq. (15)
    return Demand(load, friction_bound(p))


def friction_bound(p: Plant) -> float:
    """The right side of Lemma 2 (15), (M + m) g / (m l) mu / sqrt(mu^2 + 1), rad/s^2."""
    weight = (p.M + p.m) * p.g / (p.m * p.l)
    root = math.sqrt(p.mu * p.mu + 1.0)
    return weight * p.mu / root


def _pivot_torque(cycle: Cycle, p: Plant) -> np.ndarray:
    """k theta + c theta' where the published equations count it as a force, otherwise zero."""
    if not p.pivot_torque_on_contact:
        return np.zeros_like(cycle.theta)
    return p.k * cycle.theta + p.c * cycle.theta_dot


def evaluate_demands() -> list[dict[str, Any]]:
    """The largest load over limit of each demand on both profiles, nominal plant.

    A demand is violated above 1.

    Returns:
        By row: the name of the `profile`, the `demand` and whether it is "as printed"; the ratio
        over the `whole_cycle` and in each of the phases of the `restoring` stage.
    """
    rows = []
    for profile in (PROPOSED, EPC):
        cycle = sample(profile)
        demands = {
            "Principle 3, Newton's forces": principle_3(cycle, NEWTON),
            "Principle 3, (7) as printed": principle_3(cycle, PAPER),
            "Principle 4, Newton's forces": principle_4(cycle, NEWTON),
            "Principle 4, (8) as printed": principle_4(cycle, PAPER),
            "Lemma 2, (15) as printed": lemma_2(cycle, PAPER),
            "Lemma 2, corrected": lemma_2(cycle, NEWTON, sufficient=True),
        }
        for name, demand in demands.items():
            # A phase has SAMPLES_PER_PHASE samples.
            ratio = demand.ratio.reshape(len(profile.segments), -1)
            by_phase = ratio.max(axis=1).tolist()
            row: dict[str, Any] = {"profile": profile.name, "demand": name}
            row["whole_cycle"] = max(by_phase)
            row["restoring"] = tuple(by_phase[-RESTORING_PHASES:])
            rows.append(row)
    return rows


def check_lemmas(states: int = 200_000, seed: int = 0) -> list[dict[str, Any]]:
    """Checks both lemmas, as printed and corrected, on random states with |theta| < pi/2.

    Returns:
        By row: the `lemma`, which `forces`, the number of random `states` that meet the lemma, the
        number of these that violate the principle for which it should be sufficient (`violations`),
        and the largest load over limit of the principle among them (`worst`).
    """
    rng = np.random.default_rng(seed)
    rows = []
    for lemma, principle, printed, corrected, limits in (
        (lemma_1, principle_3, "Lemma 1 (10), as printed", "Lemma 1 (12), its own premise", FAST),
        (lemma_2, principle_4, "Lemma 2 (15), as printed", "Lemma 2 (15), corrected", SLOW),
    ):
        largest = np.array([0.5 * math.pi, *limits])
        motion = largest * rng.uniform(-1.0, 1.0, (states, 3))
        unused = np.zeros(states, np.int64)
        samples = Cycle(unused, unused, *motion.T)
        for name, forces, p in (
            (printed, "printed", PAPER),
            (corrected, "printed", PAPER),
            (corrected, "Newton's", NEWTON),
        ):
            met = lemma(samples, p, sufficient=name == corrected).ratio <= 1.0
            ratio = principle(samples, p).ratio[met]
            row: dict[str, Any] = {"lemma": name, "forces": forces}
            row["states"] = int(met.sum())
            row["violations"] = int((ratio > 1.0).sum())
            row["worst"] = float(ratio.max())
            rows.append(row)
    return rows


def torque_without_acceleration(
    theta: np.ndarray, theta_dot: float, slip: float, p: Plant
) -> np.ndarray:
    """Motor torque in N m at theta'' = 0, from Eq. (1); `slip` is +1.0, -1.0 or, for stick, 0.0."""
    ml = p.m * p.l
    sin = np.sin(theta)
    weight = -ml * p.g * sin
    at_rest = weight + p.k * theta + p.c * theta_dot
    if slip == 0.0:
        return at_rest
    normal_force = np.maximum(0.0, dynamics.normal_force(theta, theta_dot, 0.0, p))
    friction = slip * p.mu * normal_force
    driving_force = ml * sin * theta_dot**2 + friction
    moment = ml * np.cos(theta) * driving_force
    return at_rest + moment / (p.M + p.m)  # Eq. (32)


def _slope_of_torque(largest_theta: float, theta_dot: float, p: Plant) -> float:
    """Bound on |d torque / d theta| of `torque_without_acceleration`, N m/rad.

    It holds for |theta| <= largest_theta.
    """
    ml = p.m * p.l
    total = p.M + p.m
    pivot = p.k * largest_theta + p.c * abs(theta_dot)
    centrifugal = ml * theta_dot**2
    normal_force = total * p.g + 2.0 * centrifugal + 2.0 * pivot + p.k
    friction = p.mu * normal_force
    return ml * p.g + p.k + ml * (centrifugal + friction) / total


def torque_at_peak(
    velocity: float, low: float, high: float, slips: tuple[float, ...] = SLIPS
) -> float:
    """A lower bound in N m on the largest torque of every motion whose theta' has a given peak.

    The peak is in rad/s, at an angle between `low` and `high` in rad.

    Theorem. Let theta' > 0 attain its maximum V at an angle in [low, high]. Then the torque is, at
    or just before the peak, at least min over [low, high] and over the contact modes of the torque
    of Eq. (1) at theta'' = 0, theta' = V.

    Argument. In every mode Eq. (1) gives u = J theta'' + u_0(theta, theta') with J > 0: m l^2 in
    stick and m l^2 (1 - m cos (cos +- mu sin) / (M + m)) in slip, positive where the contact is
    regular. Where u is continuous, theta'' = 0 at the peak and u = u_0. Where u or the mode jumps
    there, theta' still grew towards its maximum, so theta'' >= 0 at times arbitrarily close before
    it, and there u >= u_0, which is continuous within a mode. The torque's friction enters by N at
    theta'' = 0, so both options for the normal force are searched. The minimum over a grid is
    lowered by the largest slope times half the spacing, which makes it a bound.
    """
    theta = np.linspace(low, high, SAMPLES)
    half_spacing = 0.5 * (high - low) / (SAMPLES - 1)
    largest_theta = max(abs(low), abs(high))
    bounds = []
    for p in (NEWTON, PAPER):
        margin = _slope_of_torque(largest_theta, velocity, p) * half_spacing
        for slip in slips:
            torque = torque_without_acceleration(theta, velocity, slip, p)
            bounds.append(float(torque.min()) - margin)
    return min(bounds)


def check_torques() -> list[dict[str, Any]]:
    """Certified lower bounds on the torque at the peak for both profiles, N m.

    `bound` is for any contact, `sticking` for stick. The proof holds where the `published` torque
    is below the `bound`.
    """
    rows = []
    for name, numbers in published.RUNS.items():
        velocity = numbers["peak_velocity"].value
        swing = math.radians(numbers["swing"].value)
        row: dict[str, Any] = {"name": name, "velocity": velocity}
        row["published"] = numbers["peak_torque"].value
        row["bound"] = torque_at_peak(velocity, START_THETA, swing)
        row["sticking"] = torque_at_peak(velocity, START_THETA, swing, slips=(0.0,))
        rows.append(row)
    return rows
