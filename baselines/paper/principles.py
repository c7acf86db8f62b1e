"""Principles 1 to 4 of the paper, Eqs. (5) to (8), and Lemmas 1 and 2, as margins over a cycle of a profile.

A margin is the limit minus the load: positive where the demand is met. The cycle is sampled phase by phase, both ends
included, so that the acceleration's jumps at the edges count from either side. Every function takes a profile, or
samples of any motion.

The contact comes in two forms. "newton" is the floor's true normal force and the true force of the pendulum on the
platform. "paper" is (7) and (8) as printed: they add the torque of spring and damper, k theta + c theta', to forces.
That torque acts between pendulum and platform and never on the floor, and its dimension is N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from baselines.laws.profiles import Profile
from capsule_gym.parameters import NormalForce, Plant, check_number

LemmaForm = Literal["printed", "sufficient"]

SAMPLES_PER_PHASE = 2001

# Definition 4: the restoring stage. In the profile (9) these are phases IV to VII, in EPC's its last four.
RESTORING_PHASES = 4


@dataclass(frozen=True)
class Cycle:
    """A motion in samples, in a profile's case phase by phase.

    Attributes:
        t: s; the end of a phase and the start of the next are two samples at one time.
        phase: number of the phase from 0.
        theta: rad.
        theta_dot: rad/s.
        theta_ddot: rad/s^2.
    """

    t: np.ndarray
    phase: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    theta_ddot: np.ndarray


@dataclass(frozen=True)
class Margin:
    """How far a profile stays inside one demand.

    Attributes:
        name: the demand and its equation.
        unit: of load and limit.
        cycle: the samples that it was evaluated at.
        load: what is bounded.
        limit: its bound at the same samples.
    """

    name: str
    unit: str
    cycle: Cycle
    load: np.ndarray
    limit: np.ndarray

    @property
    def margin(self) -> np.ndarray:
        """Limit minus load at every sample: positive where the demand is met."""
        return self.limit - self.load

    @property
    def factor_by_phase(self) -> np.ndarray:
        """The largest load over limit in each phase: above 1 the demand is violated by that factor."""
        phase, ratio = self.cycle.phase, self.load / self.limit
        return np.array([ratio[phase == n].max() for n in range(int(phase[-1]) + 1)])


def sample(profile: Profile, samples: int = SAMPLES_PER_PHASE) -> Cycle:
    """A cycle of the profile with the given number of samples in each phase, both of its ends included.

    Args:
        profile: the profile.
        samples: per phase, at least 2.
    """
    columns: list[list[np.ndarray]] = [[], [], [], [], []]
    begin, reached = 0.0, profile.start
    for n, segment in enumerate(profile.segments):
        s = np.linspace(0.0, segment.duration, samples)
        rows = (begin + s, np.full(samples, n), reached + segment.turned(s), segment.velocity(s))
        for column, row in zip(columns, (*rows, segment.acceleration(s)), strict=True):
            column.append(row)
        begin += segment.duration
        reached += float(segment.turned(np.float64(segment.duration)))
    return Cycle(*(np.concatenate(column) for column in columns))


def principle_1(motion: Profile | Cycle, theta_0: float) -> Margin:
    """Eq. (5): the angle stays within theta_0.

    Args:
        motion: the profile, or its samples.
        theta_0: the prescribed angle, rad.
    """
    theta_0 = check_number("theta_0", theta_0, "a finite number > 0 (rad)", 0.0, open_low=True)
    cycle = _cycle(motion)
    return _bounded("Principle 1 (5)", "rad", cycle, np.abs(cycle.theta), theta_0)


def principle_2(motion: Profile | Cycle, v_theta: float, a_theta: float) -> tuple[Margin, Margin]:
    """Eq. (6): velocity and acceleration of the pendulum stay within their bounds.

    Args:
        motion: the profile, or its samples.
        v_theta: rad/s.
        a_theta: rad/s^2.

    Returns:
        The margins of velocity and acceleration.
    """
    v_theta = check_number("v_theta", v_theta, "a finite number > 0 (rad/s)", 0.0, open_low=True)
    a_theta = check_number("a_theta", a_theta, "a finite number > 0 (rad/s^2)", 0.0, open_low=True)
    cycle = _cycle(motion)
    return (
        _bounded("Principle 2 (6), velocity", "rad/s", cycle, np.abs(cycle.theta_dot), v_theta),
        _bounded("Principle 2 (6), acceleration", "rad/s^2", cycle, np.abs(cycle.theta_ddot), a_theta),
    )


def principle_3(motion: Profile | Cycle, p: Plant, normal_force: NormalForce = "newton") -> Margin:
    """Eq. (7): the floor carries the platform throughout. Load: the pendulum's lift; limit: the weight.

    Args:
        motion: the profile, or its samples.
        p: the plant.
        normal_force: Newton's, or (7) as printed, with the pivot's torque.
    """
    cycle = _cycle(motion)
    bracket, centripetal = _parts(cycle, p, normal_force)
    load = centripetal * np.cos(cycle.theta) + bracket * np.sin(cycle.theta)
    return _bounded(f"Principle 3 (7), {normal_force}", "N", cycle, load, (p.M + p.m) * p.g)


def principle_4(motion: Profile | Cycle, p: Plant, normal_force: NormalForce = "newton") -> Margin:
    """Eq. (8): a platform at rest stays at rest. Load: the pendulum's force; limit: static friction.

    The margin covers the whole cycle. The principle asks for it after the progressive motion, that is in the last
    `RESTORING_PHASES`; in the phases before, a violation is what moves the capsule.

    Args:
        motion: the profile, or its samples.
        p: the plant.
        normal_force: Newton's with the true driving force, or both sides of (8) as printed, with the pivot's torque.
    """
    cycle = _cycle(motion)
    bracket, centripetal = _parts(cycle, p, normal_force)
    sin, cos = np.sin(cycle.theta), np.cos(cycle.theta)
    force = bracket * cos - centripetal * sin
    rough = p.mu * p.static_ratio * np.where(force < 0.0, p.backward_ratio, 1.0)
    limit = rough * ((p.M + p.m) * p.g - centripetal * cos - bracket * sin)
    return Margin(f"Principle 4 (8), {normal_force}", "N", cycle, np.abs(force), limit)


def lemma_1(
    motion: Profile | Cycle, p: Plant, normal_force: NormalForce = "newton", form: LemmaForm = "printed"
) -> Margin:
    """Lemma 1, Eq. (10), offered by the paper as sufficient for Principle 3. It is not.

    With a = m l theta'' + k theta + c theta' and b = m l theta'^2, (12) asks for sqrt(a^2 + b^2) < (M + m) g. That is
    sufficient for (7), by Cauchy and Schwarz. The step to (13), sqrt(2 a b) < (M + m) g, uses a^2 + b^2 >= 2 a b, so
    (12) implies (13) and never the other way round: (10), which is (13) squared, is necessary for (12) and sufficient
    for nothing. At theta = 0 with a = 0 it holds at every speed, and the capsule takes off beyond b = (M + m) g. Nor is
    it necessary for (7) itself: at theta = 0, where a drops out of (7), a large a violates (10) alone.

    Args:
        motion: the profile, or its samples.
        p: the plant.
        normal_force: whether a holds the pivot's torque ("paper", as printed) or not.
        form: "printed" for (10), "sufficient" for (12).
    """
    _check_form(form)
    cycle = _cycle(motion)
    bracket, centripetal = _parts(cycle, p, normal_force)
    weight = (p.M + p.m) * p.g
    if form == "sufficient":
        return _bounded("Lemma 1 (12)", "N", cycle, np.hypot(bracket, centripetal), weight)  # Eq. (12)
    load = cycle.theta_dot**2 * np.abs(bracket)
    return _bounded("Lemma 1 (10)", "N rad/s^2", cycle, load, weight**2 / (2.0 * p.m * p.l))  # Eq. (10)


def lemma_2(
    motion: Profile | Cycle, p: Plant, normal_force: NormalForce = "newton", form: LemmaForm = "printed"
) -> Margin:
    """Lemma 2, Eq. (15), offered by the paper as sufficient for Principle 4.

    As printed it bounds a sum without absolute values, so a strong deceleration passes it while the platform is pushed
    backwards, and the step to (18) drops 1 / (m l) from the terms of spring and damper, which leaves a torque beside
    an acceleration. Both mended, |theta'' + (k theta + c theta') / (m l)| + theta'^2 <= (M + m) g / (m l) mu /
    sqrt(mu^2 + 1) is sufficient for (8), by Cauchy and Schwarz, on either side.

    Args:
        motion: the profile, or its samples.
        p: the plant; its static friction is taken as isotropic, at the smaller of the two coefficients.
        normal_force: whether the torque of spring and damper enters ("paper", as printed) or not.
        form: "printed" for (15), "sufficient" for the mended one.
    """
    _check_form(form)
    cycle = _cycle(motion)
    pivot = _pivot(cycle, p, normal_force)
    mu = p.mu * p.static_ratio * min(1.0, p.backward_ratio)
    limit = (p.M + p.m) * p.g / (p.m * p.l) * mu / math.sqrt(mu * mu + 1.0)
    if form == "sufficient":
        load = np.abs(cycle.theta_ddot + pivot / (p.m * p.l)) + cycle.theta_dot**2
        return _bounded("Lemma 2 (15), sufficient", "rad/s^2", cycle, load, limit)
    load = cycle.theta_ddot + cycle.theta_dot**2 + pivot  # Eq. (15)
    return _bounded("Lemma 2 (15)", "rad/s^2", cycle, load, limit)


def _cycle(motion: Profile | Cycle) -> Cycle:
    """The samples of a motion."""
    return motion if isinstance(motion, Cycle) else sample(motion)


def _bounded(name: str, unit: str, cycle: Cycle, load: np.ndarray, limit: float) -> Margin:
    """A demand whose limit is a constant."""
    return Margin(name, unit, cycle, load, np.full_like(load, limit))


def _pivot(cycle: Cycle, p: Plant, normal_force: NormalForce) -> np.ndarray:
    """k theta + c theta' where the print counts it as a force, else zero."""
    if normal_force not in get_args(NormalForce):
        raise ValueError(f"normal_force must be 'newton' or 'paper', got {normal_force!r}")
    counted = 1.0 if normal_force == "paper" else 0.0
    return counted * (p.k * cycle.theta + p.c * cycle.theta_dot)


def _parts(cycle: Cycle, p: Plant, normal_force: NormalForce) -> tuple[np.ndarray, np.ndarray]:
    """The two forces that (7), (8) and (10) are made of: m l theta'' (with the pivot's torque) and m l theta'^2."""
    ml = p.m * p.l
    return ml * cycle.theta_ddot + _pivot(cycle, p, normal_force), ml * cycle.theta_dot**2


def _check_form(form: str) -> None:
    """Refuses what is no form of a lemma."""
    if form not in get_args(LemmaForm):
        raise ValueError(f"form must be 'printed' or 'sufficient', got {form!r}")
