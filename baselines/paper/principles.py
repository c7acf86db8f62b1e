"""Principles 3 and 4 (Eqs. 7 and 8) and Lemmas 1 and 2 of the paper.

A principle or lemma is evaluated as load and limit over a cycle of a profile, or over samples of any motion: it is met
where the load does not exceed the limit. Cycles are sampled phase by phase with both ends, so that the acceleration's
jumps count from either side.

A plant with the paper's normal force has the contact of (7) and (8) as printed: they add the torque of spring and
damper, k theta + c theta', to forces. That torque acts between pendulum and platform, never on the floor, and its
dimension is N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from baselines.laws.profiles import EPC, PROPOSED, Profile
from capsule_gym import dynamics
from capsule_gym.parameters import NOMINAL, Capsule, Plant

SAMPLES_PER_PHASE = 2001
THETA_0 = math.pi / 3.0  # the boundary condition of Sect. 3.2, rad
# Definition 4: the restoring stage. In the profile (9) these are phases IV to VII, in EPC's its last four.
RESTORING_PHASES = 4
NEWTON, PAPER = NOMINAL.plant(), Capsule(normal_force="paper").plant()
# Largest |theta'| (rad/s) and |theta''| (rad/s^2) of the random states: beyond the profiles for Lemma 1, which is about
# loss of contact, and around rest for Lemma 2, whose limit is 1.5 rad/s^2.
FAST, SLOW = (20.0, 400.0), (1.3, 20.0)


@dataclass(frozen=True)
class Cycle:
    """The samples of a motion, in SI units, with the number of their phase from 0; both phases at its ends count."""

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
        return np.divide(self.load, limit, out=np.full_like(self.load, math.inf), where=limit > 0.0)


def sample(profile: Profile, samples: int = SAMPLES_PER_PHASE) -> Cycle:
    """A cycle of the profile with the given number of samples in each phase, both of its ends included."""
    phases, begin, reached = [], 0.0, profile.start
    for n, segment in enumerate(profile.segments):
        s = np.linspace(0.0, segment.duration, samples)
        angle, velocity, acceleration = segment.turned(s), segment.velocity(s), segment.acceleration(s)
        phases.append((begin + s, np.full(samples, n), reached + angle, velocity, acceleration))
        begin, reached = begin + segment.duration, reached + float(angle[-1])
    return Cycle(*(np.concatenate(columns) for columns in zip(*phases, strict=True)))


def principle_3(cycle: Cycle, p: Plant) -> Demand:
    """Eq. (7): the platform keeps contact with the floor. Load: the pendulum's lift, N; limit: the weight, N."""
    weight = (p.M + p.m) * p.g
    return Demand(weight - dynamics.normal_force(*cycle.motion, p), weight)


def principle_4(cycle: Cycle, p: Plant) -> Demand:
    """Eq. (8): a platform at rest stays at rest. Load: the pendulum's force, N; limit: the static friction, N.

    The principle applies to the restoring stage, the last `RESTORING_PHASES`. In the phases before, a violation is what
    moves the capsule.
    """
    force = dynamics.driving_force(*cycle.motion, p) + _pivot_torque(cycle, p) * np.cos(cycle.theta)
    mu = p.mu * p.static_ratio * np.where(force < 0.0, p.backward_ratio, 1.0)
    return Demand(np.abs(force), mu * dynamics.normal_force(*cycle.motion, p))


def lemma_1(cycle: Cycle, p: Plant, *, sufficient: bool = False) -> Demand:
    """Lemma 1, Eq. (10), which the paper presents as sufficient for Principle 3; `sufficient` gives its premise (12).

    With a = m l theta'' + k theta + c theta' and b = m l theta'^2, (12), sqrt(a^2 + b^2) < (M + m) g, is sufficient by
    Cauchy and Schwarz. (10) follows from (12) and is sufficient for nothing: at theta = 0 with a = 0 it holds at every
    speed. Nor is it necessary for (7), in which a drops out at theta = 0.
    """
    ml, weight = p.m * p.l, (p.M + p.m) * p.g
    a = ml * cycle.theta_ddot + _pivot_torque(cycle, p)
    if sufficient:
        return Demand(np.hypot(a, ml * cycle.theta_dot**2), weight)  # Eq. (12)
    return Demand(cycle.theta_dot**2 * np.abs(a), weight**2 / (2.0 * ml))  # Eq. (10)


def lemma_2(cycle: Cycle, p: Plant, *, sufficient: bool = False) -> Demand:
    """Lemma 2, Eq. (15), which the paper presents as sufficient for Principle 4; `sufficient` gives the corrected form.

    As printed a strong deceleration meets it, and the terms of spring and damper lack 1 / (m l). Corrected,
    |theta'' + (k theta + c theta') / (m l)| + theta'^2 <= (M + m) g / (m l) mu / sqrt(mu^2 + 1) is sufficient for (8)
    by Cauchy and Schwarz. Friction is that of a plant with one coefficient.
    """
    torque = _pivot_torque(cycle, p)
    if sufficient:
        load = np.abs(cycle.theta_ddot + torque / (p.m * p.l)) + cycle.theta_dot**2
    else:
        load = cycle.theta_ddot + cycle.theta_dot**2 + torque  # Eq. (15)
    return Demand(load, friction_bound(p))


def friction_bound(p: Plant) -> float:
    """The right side of Lemma 2 (15), (M + m) g / (m l) mu / sqrt(mu^2 + 1), rad/s^2."""
    return (p.M + p.m) * p.g / (p.m * p.l) * p.mu / math.sqrt(p.mu * p.mu + 1.0)


def _pivot_torque(cycle: Cycle, p: Plant) -> np.ndarray:
    """k theta + c theta' where the print counts it as a force, otherwise zero."""
    return p.pivot_torque_on_contact * (p.k * cycle.theta + p.c * cycle.theta_dot)


def evaluate_demands() -> list[dict[str, Any]]:
    """The demands on both profiles, nominal plant: the largest load over limit, above 1 where it is violated.

    Returns:
        By row: the name of the `profile`, the `demand` and whether it is "as printed"; the ratio over the `whole_cycle`
        and in each of the phases of the `restoring` stage.
    """
    rows = []
    for profile in (PROPOSED, EPC):
        cycle, count = sample(profile), len(profile.segments)
        for name, demand in (
            ("Principle 3, Newton's forces", principle_3(cycle, NEWTON)),
            ("Principle 3, (7) as printed", principle_3(cycle, PAPER)),
            ("Principle 4, Newton's forces", principle_4(cycle, NEWTON)),
            ("Principle 4, (8) as printed", principle_4(cycle, PAPER)),
            ("Lemma 2, (15) as printed", lemma_2(cycle, PAPER)),
            ("Lemma 2, corrected", lemma_2(cycle, NEWTON, sufficient=True)),
        ):
            factors = tuple(float(demand.ratio[cycle.phase == n].max()) for n in range(count))
            row = {"profile": profile.name, "demand": name, "whole_cycle": max(factors)}
            rows.append({**row, "restoring": factors[-RESTORING_PHASES:]})
    return rows


def check_lemmas(states: int = 200_000, seed: int = 0) -> list[dict[str, Any]]:
    """Both lemmas, as printed and corrected, each on random states with |theta| < pi/2.

    Returns:
        By row: the `lemma`, which `forces`, the number of random `states` that meet the lemma, the number of these that
        violate the principle for which it should be sufficient (`violations`), and the largest load over limit of the
        principle among them (`worst`).
    """
    rng, rows = np.random.default_rng(seed), []
    for lemma, principle, names, limits in (
        (lemma_1, principle_3, ("Lemma 1 (10), as printed", "Lemma 1 (12), its own premise"), FAST),
        (lemma_2, principle_4, ("Lemma 2 (15), as printed", "Lemma 2 (15), corrected"), SLOW),
    ):
        values = np.array([0.5 * math.pi, *limits]) * rng.uniform(-1.0, 1.0, (states, 3))
        random = Cycle(np.zeros(states), np.zeros(states, np.int64), *values.T)
        for sufficient, forces, p in ((False, "printed", PAPER), (True, "printed", PAPER), (True, "Newton's", NEWTON)):
            met = lemma(random, p, sufficient=sufficient).ratio <= 1.0
            ratio = principle(random, p).ratio[met]
            row = {"lemma": names[sufficient], "forces": forces, "states": int(met.sum())}
            rows.append({**row, "violations": int((ratio > 1.0).sum()), "worst": float(ratio.max())})
    return rows
