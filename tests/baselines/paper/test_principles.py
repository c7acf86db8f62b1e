"""Principles 1 to 4 and both Lemmas: hand-computed points, what the published profile violates, what implies what."""

from __future__ import annotations

import math

import numpy as np
import pytest

from baselines.laws.profiles import EPC, PROPOSED, Profile, Segment
from baselines.paper.principles import lemma_1, lemma_2, principle_1, principle_2, principle_3, principle_4, sample
from capsule_gym import dynamics
from capsule_gym.parameters import Capsule

NOMINAL = Capsule().plant()
ML = 0.138 * 0.3
WEIGHT = 0.638 * 9.81


def steady(start: float, speed: float, acceleration: float = 0.0) -> Profile:
    """One phase that begins with the given angle, speed and acceleration; only its first sample is of interest."""
    return Profile("point", (Segment(1e-3, offset=speed, slope=acceleration),), start)


def by_phase(margin):
    """The smallest margin in each phase."""
    return np.array([margin.margin[margin.cycle.phase == n].min() for n in range(int(margin.cycle.phase[-1]) + 1)])


def test_samples_meet_both_ends_of_every_phase():
    cycle = sample(PROPOSED, 3)
    assert cycle.t.tolist() == pytest.approx(
        [x for a, b in zip([0, *PROPOSED.times], PROPOSED.times, strict=False) for x in (a, (a + b) / 2, b)]
    )
    # The acceleration drops from that of phase III to that of phase IV at t3, and both are there.
    at_t3 = cycle.theta_ddot[np.isclose(cycle.t, 0.27)]
    assert at_t3.tolist() == pytest.approx([-129.63, -2.122 / 0.63], rel=1e-4)
    inside = np.isin(np.arange(21) % 3, [1])
    for mine, theirs in zip(
        (cycle.theta, cycle.theta_dot, cycle.theta_ddot), PROPOSED.evaluate(cycle.t[inside]), strict=True
    ):
        np.testing.assert_allclose(mine[inside], theirs, rtol=1e-12, atol=1e-12)


def test_margins_of_principles_1_and_2():
    assert by_phase(principle_1(PROPOSED, math.radians(70.0))).min() == pytest.approx(math.radians(1.25), abs=2e-4)
    velocity, acceleration = principle_2(PROPOSED, 8.0, 200.0)
    assert by_phase(velocity).min() == pytest.approx(0.2)
    assert by_phase(velocity)[4:] == pytest.approx([8.0 - PROPOSED.restoring_speed] * 3)
    # Phase I starts with 7.8 pi / (2 0.133).
    assert by_phase(acceleration)[0] == pytest.approx(200.0 - 7.8 * math.pi / 0.266)
    assert by_phase(acceleration)[1] == 200.0


@pytest.mark.parametrize("normal_force", ["newton", "paper"])
def test_contact_margin_is_the_normal_force(normal_force):
    p = Capsule(normal_force=normal_force).plant()
    cycle = sample(PROPOSED, 5)
    margin = principle_3(PROPOSED, p, normal_force).margin.reshape(7, -1)[:, ::500].ravel()
    states = zip(cycle.theta.tolist(), cycle.theta_dot.tolist(), cycle.theta_ddot.tolist(), strict=True)
    np.testing.assert_allclose(margin, [dynamics.normal_force(*state, p) for state in states], rtol=1e-12)


def test_principle_3_by_hand():
    # Upright: the bracket drops out, and the centripetal force alone lifts, m l 10^2 = 4.14 N.
    for normal_force in ("newton", "paper"):
        assert principle_3(steady(0.0, 10.0, 50.0), NOMINAL, normal_force).margin[0] == pytest.approx(WEIGHT - 4.14)
    # Level: the centripetal force drops out; the spring's torque of 0.36 pi / 2 counts as newtons in the print.
    level = steady(math.pi / 2, 0.0, 50.0)
    assert principle_3(level, NOMINAL).margin[0] == pytest.approx(WEIGHT - 2.07)
    assert principle_3(level, NOMINAL, "paper").margin[0] == pytest.approx(WEIGHT - 2.07 - 0.18 * math.pi)


def test_principle_4_by_hand():
    newton = principle_4(steady(0.0, 0.0, -1.0), NOMINAL)
    assert (newton.load[0], newton.limit[0]) == pytest.approx((ML, 0.01 * WEIGHT))
    printed = principle_4(steady(0.0, 0.0, -1.0), NOMINAL, "paper")
    assert printed.load[0] == pytest.approx(ML)
    # At -pi/3 and at rest only the spring is left, 0.36 pi / 3 cos(pi / 3), three times the friction limit.
    rest = principle_4(steady(-math.pi / 3, 0.0), NOMINAL, "paper")
    assert rest.load[0] == pytest.approx(0.06 * math.pi)
    assert rest.load[0] / rest.limit[0] == pytest.approx(0.06 * math.pi / (0.01 * (WEIGHT - 0.06 * math.pi * 3**0.5)))
    assert principle_4(steady(-math.pi / 3, 0.0), NOMINAL).load[0] == 0.0
    # Friction that differs by direction: a negative acceleration upright pushes backwards.
    rough = Capsule(backward_ratio=3.0, static_ratio=2.0).plant()
    assert principle_4(steady(0.0, 0.0, -1.0), rough).limit[0] == pytest.approx(0.06 * WEIGHT)
    assert principle_4(steady(0.0, 0.0, 1.0), rough).limit[0] == pytest.approx(0.02 * WEIGHT)


def test_published_profile_violates_printed_principle_4():
    factors = principle_4(PROPOSED, NOMINAL, "paper").factor_by_phase
    assert factors[3:] == pytest.approx([2.197, 2.530, 3.729, 3.456], abs=1e-3)
    assert (by_phase(principle_4(PROPOSED, NOMINAL, "paper"))[3:] < 0.0).all()


def test_published_profile_keeps_newtons_principle_4_in_its_return():
    margin = principle_4(PROPOSED, NOMINAL)
    assert margin.factor_by_phase[3:] == pytest.approx([3.480, 0.317, 0.118, 0.351], abs=1e-3)
    assert by_phase(margin)[-3:].min() > 0.0 > by_phase(margin)[-4:].min()


def test_lemma_1_is_necessary_for_12_and_sufficient_for_nothing():
    # (12) implies (10), point by point, on anything.
    for profile in (PROPOSED, EPC):
        for normal_force in ("newton", "paper"):
            strong = lemma_1(profile, NOMINAL, normal_force, "sufficient").margin
            printed = lemma_1(profile, NOMINAL, normal_force).margin
            assert (printed[strong >= 0.0] >= 0.0).all()
            assert (principle_3(profile, NOMINAL, normal_force).margin[strong >= 0.0] >= -1e-12).all()
    # EPC keeps (10) and breaks (12): the step from (13) back to (12) does not exist.
    assert (
        by_phase(lemma_1(EPC, NOMINAL, "paper")).min()
        > 0.0
        > by_phase(lemma_1(EPC, NOMINAL, "paper", "sufficient")).min()
    )
    # (10) does not keep the capsule on the floor: upright at 15 rad/s with a bracket of zero.
    flying = steady(0.0, 15.0, -0.0923 * 15.0 / ML)
    assert lemma_1(flying, NOMINAL, "paper").margin[0] == pytest.approx(WEIGHT**2 / (2 * ML))
    assert principle_3(flying, NOMINAL, "paper").margin[0] == pytest.approx(WEIGHT - ML * 225.0)
    assert principle_3(flying, NOMINAL, "paper").margin[0] < 0.0
    # Nor does the floor need it: upright the acceleration does not enter (7).
    standing = steady(0.0, 10.0, 400.0)
    assert lemma_1(standing, NOMINAL).margin[0] < 0.0 < principle_3(standing, NOMINAL).margin[0]


def test_lemma_2_by_hand():
    bound = WEIGHT / ML * 0.01 / math.sqrt(1.0001)
    printed = lemma_2(steady(-0.5, 0.2, 0.7), NOMINAL, "paper")
    assert printed.load[0] == pytest.approx(0.7 + 0.04 - 0.18 + 0.01846)
    assert printed.limit[0] == pytest.approx(bound)
    mended = lemma_2(steady(-0.5, 0.2, 0.7), NOMINAL, "paper", "sufficient")
    assert mended.load[0] == pytest.approx(abs(0.7 + (-0.18 + 0.01846) / ML) + 0.04)


@pytest.mark.parametrize("normal_force", ["newton", "paper"])
def test_mended_lemma_2_implies_principle_4(normal_force):
    rng = np.random.default_rng(0)
    implied = 0
    for _ in range(400):
        theta, speed, acceleration = rng.uniform([-1.5, -1.2, -3.0], [1.5, 1.2, 3.0])
        if normal_force == "paper":
            # Where the spring's torque and the acceleration all but cancel.
            acceleration -= (0.36 * theta + 0.0923 * speed) / ML
        point = steady(theta, speed, acceleration)
        if lemma_2(point, NOMINAL, normal_force, "sufficient").margin[0] >= 0.0:
            implied += 1
            assert principle_4(point, NOMINAL, normal_force).margin[0] >= 0.0
    assert implied > 50


def test_printed_lemma_2_does_not_imply_principle_4():
    # A deceleration passes it by its sign. The published return keeps it, and violates printed (8) threefold.
    assert by_phase(lemma_2(PROPOSED, NOMINAL, "paper"))[-3:].min() > 0.0
    assert by_phase(principle_4(PROPOSED, NOMINAL, "paper"))[-3:].min() < 0.0
    # In phase IV it is met with equality but for the digits of Table 1: that is where (27) comes from.
    assert lemma_2(PROPOSED, NOMINAL, "paper").factor_by_phase[3] == pytest.approx(1.0, abs=0.01)
    assert principle_4(PROPOSED, NOMINAL, "paper").factor_by_phase[3] > 2.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: principle_1(PROPOSED, 0.0), "theta_0 must be"),
        (lambda: principle_2(PROPOSED, math.nan, 1.0), "v_theta must be"),
        (lambda: principle_2(PROPOSED, 1.0, -1.0), "a_theta must be"),
        (lambda: principle_3(PROPOSED, NOMINAL, "einstein"), "normal_force must be 'newton' or 'paper', got 'einst"),
        (lambda: lemma_2(PROPOSED, NOMINAL, "newton", "mended"), "form must be"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
