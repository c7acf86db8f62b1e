"""Principles 1 to 4 (Eqs. 5 to 8) and Lemmas 1 and 2 of the paper.

A principle or lemma is evaluated as load and limit over a cycle of a profile, or over samples of any motion: it is met
where the load does not exceed the limit. Cycles are sampled phase by phase with both ends, so that the acceleration's
jumps count from either side.

The contact has two forms. "newton" is the true normal force and the true force of the pendulum on the platform. "paper"
is (7) and (8) as printed: they add the torque of spring and damper, k theta + c theta', to forces. That torque acts
between pendulum and platform, never on the floor, and its dimension is N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.laws.profiles import EPC, PROPOSED, Profile
from capsule_gym.parameters import NOMINAL, NormalForce, Plant

SAMPLES_PER_PHASE = 2001
THETA_0 = math.pi / 3.0  # the boundary condition of Sect. 3.2, rad
# Definition 4: the restoring stage. In the profile (9) these are phases IV to VII, in EPC's its last four.
RESTORING_PHASES = 4
AS_PRINTED, NEWTON, CORRECTED = "as printed", "Newton's forces", "corrected, Newton's forces"
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


@dataclass(frozen=True)
class Demand:
    """A principle or lemma over a motion: the bounded quantity and its bound at every sample."""

    cycle: Cycle
    load: np.ndarray
    limit: np.ndarray | float

    @property
    def ratio(self) -> np.ndarray:
        """Load over limit; infinite where the limit is not positive and therefore never met."""
        limit = np.broadcast_to(self.limit, self.load.shape)
        return np.divide(self.load, limit, out=np.full_like(self.load, math.inf), where=limit > 0.0)

    @property
    def by_phase(self) -> np.ndarray:
        """The largest load over limit in each phase: above 1 the demand is violated by that factor."""
        return np.array([self.ratio[self.cycle.phase == n].max() for n in range(int(self.cycle.phase.max()) + 1)])


def sample(profile: Profile, samples: int = SAMPLES_PER_PHASE) -> Cycle:
    """A cycle of the profile with the given number of samples in each phase, both of its ends included."""
    phases, begin, reached = [], 0.0, profile.start
    for n, segment in enumerate(profile.segments):
        s = np.linspace(0.0, segment.duration, samples)
        angle, velocity, acceleration = segment.turned(s), segment.velocity(s), segment.acceleration(s)
        phases.append((begin + s, np.full(samples, n), reached + angle, velocity, acceleration))
        begin, reached = begin + segment.duration, reached + float(angle[-1])
    return Cycle(*(np.concatenate(columns) for columns in zip(*phases, strict=True)))


def principle_3(cycle: Cycle, p: Plant, form: NormalForce = "newton") -> Demand:
    """Eq. (7): the platform keeps contact with the floor. Load: the pendulum's lift, N; limit: the weight, N."""
    tangential, centripetal = _forces(cycle, p, form)
    return Demand(cycle, centripetal * np.cos(cycle.theta) + tangential * np.sin(cycle.theta), (p.M + p.m) * p.g)


def principle_4(cycle: Cycle, p: Plant, form: NormalForce = "newton") -> Demand:
    """Eq. (8): a platform at rest stays at rest. Load: the pendulum's force, N; limit: the static friction, N.

    The principle applies to the restoring stage, the last `RESTORING_PHASES`. In the phases before, a violation is what
    moves the capsule.
    """
    tangential, centripetal = _forces(cycle, p, form)
    sin, cos = np.sin(cycle.theta), np.cos(cycle.theta)
    force = tangential * cos - centripetal * sin
    mu = p.mu * p.static_ratio * np.where(force < 0.0, p.backward_ratio, 1.0)
    return Demand(cycle, np.abs(force), mu * ((p.M + p.m) * p.g - centripetal * cos - tangential * sin))


def lemma_1(cycle: Cycle, p: Plant, form: NormalForce = "newton", *, sufficient: bool = False) -> Demand:
    """Lemma 1, Eq. (10), which the paper presents as sufficient for Principle 3; `sufficient` gives its premise (12).

    With a = m l theta'' + k theta + c theta' and b = m l theta'^2, (12), sqrt(a^2 + b^2) < (M + m) g, is sufficient by
    Cauchy and Schwarz. (10) follows from (12) and is sufficient for nothing: at theta = 0 with a = 0 it holds at every
    speed. Nor is it necessary for (7), in which a drops out at theta = 0.
    """
    a, b = _forces(cycle, p, form)
    weight = (p.M + p.m) * p.g
    if sufficient:
        return Demand(cycle, np.hypot(a, b), weight)  # Eq. (12)
    return Demand(cycle, cycle.theta_dot**2 * np.abs(a), weight**2 / (2.0 * p.m * p.l))  # Eq. (10)


def lemma_2(cycle: Cycle, p: Plant, form: NormalForce = "newton", *, sufficient: bool = False) -> Demand:
    """Lemma 2, Eq. (15), which the paper presents as sufficient for Principle 4; `sufficient` gives the corrected form.

    As printed a strong deceleration meets it, and the terms of spring and damper lack 1 / (m l). Corrected,
    |theta'' + (k theta + c theta') / (m l)| + theta'^2 <= (M + m) g / (m l) mu / sqrt(mu^2 + 1) is sufficient for (8)
    by Cauchy and Schwarz. The static friction is taken as isotropic, at the smaller of the two coefficients.
    """
    mu = p.mu * p.static_ratio * min(1.0, p.backward_ratio)
    limit = friction_bound(p._replace(mu=mu))
    if sufficient:
        return Demand(cycle, np.abs(_forces(cycle, p, form)[0]) / (p.m * p.l) + cycle.theta_dot**2, limit)
    return Demand(cycle, cycle.theta_ddot + cycle.theta_dot**2 + _pivot_torque(cycle, p, form), limit)  # Eq. (15)


def friction_bound(p: Plant) -> float:
    """The right side of Lemma 2 (15), (M + m) g / (m l) mu / sqrt(mu^2 + 1), rad/s^2."""
    return (p.M + p.m) * p.g / (p.m * p.l) * p.mu / math.sqrt(p.mu * p.mu + 1.0)


def _pivot_torque(cycle: Cycle, p: Plant, form: NormalForce) -> np.ndarray:
    """k theta + c theta' where the print counts it as a force, otherwise zero."""
    return (1.0 if form == "paper" else 0.0) * (p.k * cycle.theta + p.c * cycle.theta_dot)


def _forces(cycle: Cycle, p: Plant, form: NormalForce) -> tuple[np.ndarray, np.ndarray]:
    """The two forces in (7), (8) and (10), N: m l theta'' (with the pivot's torque as printed) and m l theta'^2."""
    return p.m * p.l * cycle.theta_ddot + _pivot_torque(cycle, p, form), p.m * p.l * cycle.theta_dot**2


def evaluate_demands() -> list[dict[str, Any]]:
    """Every demand on both profiles, nominal plant: the largest load over limit, above 1 where it is violated.

    Principle 1 takes the theta_0 = 60 degrees of Sect. 3.2. The bounds of Principle 2 are not published: the largest
    velocity and acceleration of the proposed profile are used.

    Returns:
        By row: the name of the `profile`, the `demand` and which forces or whose bounds (`form`); the ratio over the
        phases before the restoring stage (`progressive`) and in each of the four phases of it (`restoring`); whether
        the demand applies to the whole cycle (`whole_cycle`), and whether the profile meets it where it applies
        (`met`).
    """
    p, rows = NOMINAL.plant(), []
    own = sample(PROPOSED)
    v_theta, a_theta = (float(np.abs(values).max()) for values in (own.theta_dot, own.theta_ddot))
    bounds = "bounds: the proposed profile's"
    for profile in (PROPOSED, EPC):
        cycle = sample(profile)
        table = [
            ("Principle 1 (5)", "theta_0 = 60 deg", Demand(cycle, np.abs(cycle.theta), THETA_0)),
            ("Principle 2 (6), theta'", bounds, Demand(cycle, np.abs(cycle.theta_dot), v_theta)),
            ("Principle 2 (6), theta''", bounds, Demand(cycle, np.abs(cycle.theta_ddot), a_theta)),
            ("Principle 3 (7)", NEWTON, principle_3(cycle, p)),
            ("Principle 3 (7)", AS_PRINTED, principle_3(cycle, p, "paper")),
            ("Lemma 1 (10)", AS_PRINTED, lemma_1(cycle, p, "paper")),
            ("Lemma 1 (12)", NEWTON, lemma_1(cycle, p, sufficient=True)),
            ("Principle 4 (8)", NEWTON, principle_4(cycle, p)),
            ("Principle 4 (8)", AS_PRINTED, principle_4(cycle, p, "paper")),
            ("Lemma 2 (15)", AS_PRINTED, lemma_2(cycle, p, "paper")),
            ("Lemma 2 (15)", CORRECTED, lemma_2(cycle, p, sufficient=True)),
        ]
        for name, form, demand in table:
            factors = demand.by_phase.tolist()
            row: dict[str, Any] = {"profile": profile.name, "demand": name, "form": form}
            row["progressive"], row["restoring"] = max(factors[:-RESTORING_PHASES]), tuple(factors[-RESTORING_PHASES:])
            row["whole_cycle"] = not name.startswith(("Principle 4", "Lemma 2"))
            met = max(factors if row["whole_cycle"] else row["restoring"]) <= 1.0
            rows.append({**row, "met": met})
    return rows


def check_lemmas(states: int = 200_000, seed: int = 0) -> list[dict[str, Any]]:
    """Both lemmas, as printed and corrected, each on random states with |theta| < pi/2.

    Returns:
        By row: the `lemma`, which forces (`form`), the `principle` for which it should be sufficient; the number of
        random `states` that meet the lemma, the number of these that violate the principle (`violations`), and the
        largest load over limit of the principle among them (`worst`).
    """
    rng, p, rows = np.random.default_rng(seed), NOMINAL.plant(), []
    forms: list[tuple[bool, str, NormalForce]] = [
        (False, AS_PRINTED, "paper"),
        (True, "forces as printed", "paper"),
        (True, NEWTON, "newton"),
    ]
    for lemma, principle, equation, names, limits in (
        (lemma_1, principle_3, "Principle 3 (7)", ("(10), as printed", "(12), its own premise"), FAST),
        (lemma_2, principle_4, "Principle 4 (8)", ("(15), as printed", "(15), corrected"), SLOW),
    ):
        values = np.array([0.5 * math.pi, *limits]) * rng.uniform(-1.0, 1.0, (states, 3))
        random = Cycle(np.zeros(states), np.zeros(states, np.int64), *values.T)
        for sufficient, label, form in forms:
            met = lemma(random, p, form, sufficient=sufficient).ratio <= 1.0
            ratio = principle(random, p, form).ratio[met]
            row = {"lemma": names[sufficient], "form": label, "principle": equation, "states": int(met.sum())}
            rows.append({**row, "violations": int((ratio > 1.0).sum()), "worst": float(ratio.max())})
    return rows
