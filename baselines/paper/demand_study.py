"""How both profiles keep Principles 1 to 4 and Lemmas 1 and 2, and whether the lemmas imply the principles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from baselines.laws.profiles import EPC, PROPOSED, Profile
from baselines.paper.exact_tracking import published_bounds
from baselines.paper.principles import (
    RESTORING_PHASES,
    Cycle,
    Margin,
    lemma_1,
    lemma_2,
    principle_1,
    principle_2,
    principle_3,
    principle_4,
)
from baselines.paper.selection import THETA_0
from capsule_gym.parameters import NOMINAL, NormalForce, Plant

AS_PRINTED, NEWTON, MENDED = "as printed", "Newton's forces", "mended, Newton's forces"
STATES = 200_000
SEED = 0
# Largest |theta'| (rad/s) and |theta''| (rad/s^2) of the random states: beyond the profiles for Lemma 1, which is about
# losing the floor, and around rest for Lemma 2, whose limit is 1.5 rad/s^2.
FLYING, STANDING = (20.0, 400.0), (1.3, 20.0)


@dataclass(frozen=True)
class Keeping:
    """How one profile keeps one demand: the largest load over limit, above 1 where it is violated.

    Attributes:
        profile: its name.
        demand: the demand and its equation.
        form: which forces, or whose bounds.
        progressive: over the phases before the restoring stage.
        restoring: in each of the four phases of the restoring stage.
        throughout: whether the demand is made on the whole cycle, not on the restoring stage alone.
    """

    profile: str
    demand: str
    form: str
    progressive: float
    restoring: tuple[float, ...]
    throughout: bool

    @property
    def kept(self) -> bool:
        """Whether the profile meets the demand wherever it is made."""
        return max(*self.restoring, self.progressive if self.throughout else 0.0) <= 1.0


@dataclass(frozen=True)
class Implication:
    """A lemma against the principle that it is to be sufficient for, on random states of the pendulum.

    Attributes:
        lemma: its equation.
        form: which forces.
        principle: its equation.
        states: random states that meet the lemma.
        violations: of these, states that violate the principle.
        worst: the largest load over limit of the principle among them.
    """

    lemma: str
    form: str
    principle: str
    states: int
    violations: int
    worst: float


def keepings() -> tuple[Keeping, ...]:
    """Every demand for both profiles on the nominal plant.

    Principle 1 is taken with the theta_0 = 60 degrees of Sect. 3.2. The bounds of Principle 2 are not published: the
    proposed profile's own largest velocity and acceleration stand in.
    """
    return tuple(keeping for profile in (PROPOSED, EPC) for keeping in _keepings(profile))


def _keepings(profile: Profile) -> list[Keeping]:
    """Every demand for one profile."""
    p = NOMINAL.plant()
    _, v_theta, a_theta = published_bounds()
    velocity, acceleration = principle_2(profile, v_theta, a_theta)
    own = "bounds: the proposed profile's"
    rows: list[tuple[str, str, Margin, bool]] = [
        ("Principle 1 (5)", "theta_0 = 60 deg", principle_1(profile, THETA_0), True),
        ("Principle 2 (6), theta'", own, velocity, True),
        ("Principle 2 (6), theta''", own, acceleration, True),
        ("Principle 3 (7)", NEWTON, principle_3(profile, p), True),
        ("Principle 3 (7)", AS_PRINTED, principle_3(profile, p, "paper"), True),
        ("Lemma 1 (10)", AS_PRINTED, lemma_1(profile, p, "paper"), True),
        ("Lemma 1 (12)", NEWTON, lemma_1(profile, p, "newton", "sufficient"), True),
        ("Principle 4 (8)", NEWTON, principle_4(profile, p), False),
        ("Principle 4 (8)", AS_PRINTED, principle_4(profile, p, "paper"), False),
        ("Lemma 2 (15)", AS_PRINTED, lemma_2(profile, p, "paper"), False),
        ("Lemma 2 (15)", MENDED, lemma_2(profile, p, "newton", "sufficient"), False),
    ]
    return [_keeping(profile.name, *row) for row in rows]


def _keeping(profile: str, demand: str, form: str, margin: Margin, throughout: bool) -> Keeping:
    """A margin in numbers."""
    factors = margin.factor_by_phase
    restoring = tuple(float(factor) for factor in factors[-RESTORING_PHASES:])
    return Keeping(profile, demand, form, float(factors[:-RESTORING_PHASES].max()), restoring, throughout)


def implications(states: int = STATES, seed: int = SEED) -> tuple[Implication, ...]:
    """Both lemmas, as printed and mended, on random states with |theta| < pi/2.

    Args:
        states: that are drawn for each lemma.
        seed: of the drawing.
    """
    rng = np.random.default_rng(seed)
    p = NOMINAL.plant()
    flying, standing = (_random_states(rng, states, *limits) for limits in (FLYING, STANDING))
    forms: tuple[tuple[str, NormalForce], ...] = (("forces as printed", "paper"), (NEWTON, "newton"))
    found = [_implication("(10), as printed", AS_PRINTED, lemma_1(flying, p, "paper"), principle_3, "paper", p)]
    for name, force in forms:
        margin = lemma_1(flying, p, force, "sufficient")
        found.append(_implication("(12), its own premise", name, margin, principle_3, force, p))
    found.append(_implication("(15), as printed", AS_PRINTED, lemma_2(standing, p, "paper"), principle_4, "paper", p))
    for name, force in forms:
        margin = lemma_2(standing, p, force, "sufficient")
        found.append(_implication("(15), mended", name, margin, principle_4, force, p))
    return tuple(found)


def _random_states(rng: np.random.Generator, count: int, largest_velocity: float, largest_acceleration: float) -> Cycle:
    """States of the pendulum in no order, evenly distributed."""
    limits = np.array([0.5 * math.pi, largest_velocity, largest_acceleration])
    theta, theta_dot, theta_ddot = (limits * rng.uniform(-1.0, 1.0, (count, 3))).T
    return Cycle(np.zeros(count), np.zeros(count, np.int64), theta, theta_dot, theta_ddot)


def _implication(
    lemma: str,
    form: str,
    margin: Margin,
    principle: Callable[[Cycle, Plant, NormalForce], Margin],
    normal_force: NormalForce,
    p: Plant,
) -> Implication:
    """The principle where the lemma is met."""
    meets = margin.margin >= 0.0
    asked = principle(margin.cycle, p, normal_force)
    # Where the printed (8) has a limit below zero nothing keeps it.
    ratio = np.where(asked.limit > 0.0, asked.load / np.where(asked.limit > 0.0, asked.limit, 1.0), math.inf)[meets]
    name = asked.name.partition(",")[0]
    return Implication(lemma, form, name, int(meets.sum()), int((ratio > 1.0).sum()), float(ratio.max()))
