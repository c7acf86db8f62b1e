"""The paper's parameter selection (20) to (31), against numbers worked out by hand and against Table 1."""

from __future__ import annotations

import math

import pytest

from baselines.laws.profiles import PROPOSED, TABLE_1, seven_phases
from baselines.paper import selection
from baselines.paper.selection import boundary_condition, what_follows


def test_bound_of_lemma_2():
    # 0.638 9.81 / (0.138 0.3) 0.01 / sqrt(1.0001)
    assert selection.friction_bound() == pytest.approx(151.178 * 0.0099995, rel=1e-5)


def test_equation_24_both_ways():
    # ((0.638 9.81)^2 / (2 0.0414) / 7.8^3 - 0.0923) / 0.36 = (473.09 / 474.55 - 0.0923) / 0.36
    assert selection.eq_24_t1() == pytest.approx(2.513, abs=2e-3)
    assert selection.eq_24_v1(selection.eq_24_t1(5.0)) == pytest.approx(5.0, rel=1e-12)
    assert selection.eq_24_v1(0.133) == pytest.approx(15.0, abs=5e-3)


def test_equation_25_branches_differ_by_the_reflected_angle():
    omega = 11.0
    rising, falling = selection.eq_25_t2(omega), selection.eq_25_t2(omega, falling=True)
    assert rising - falling == pytest.approx(math.pi - 2.0 * math.asin(2.122 / 7.8), rel=1e-12)


def test_equation_27_both_ways():
    P2 = selection.eq_27_p2()
    assert selection.eq_27_t4(P2) == pytest.approx(0.9, rel=1e-12)
    # It is Lemma 2 with an equals sign, at theta'' = -P2 / (t4 - t3) and theta = P2 t3.
    load = -P2 / 0.63 + P2 * P2 + 0.36 * P2 * 0.27 + 0.0923 * P2
    assert load == pytest.approx(selection.friction_bound(), rel=1e-12)


def test_equation_23_closes_the_cycle_that_reaches_theta_0():
    condition = boundary_condition()
    profile = seven_phases(TABLE_1, condition.V1, selection.P2)
    assert selection.eq_23_p3(selection.P2) == pytest.approx(profile.restoring_speed, rel=1e-9)
    assert condition.largest_angle == pytest.approx(profile.peak_to_peak - math.pi / 3, abs=1e-6)
    assert selection.eq_23_p3(selection.P2) > PROPOSED.restoring_speed


def test_equations_30_and_31_are_23_and_equal_durations():
    # P3 (t6 - t4) and P3 (t7 - t5) are each the angle of the return, 2 theta_0 and half of P2 (t4 - t3).
    P3 = 0.4
    angle = 2.0 * selection.THETA_0 + 0.5 * selection.P2 * 0.63
    assert P3 * (selection.eq_30_t6(selection.P2, P3) - 0.9) == pytest.approx(angle, rel=1e-12)
    assert P3 * (selection.eq_31_t7(selection.P2, P3) - 1.7) == pytest.approx(angle, rel=1e-12)


# What each row gives and implies, to half a unit of the last digit given.
EXPECTED = [
    ("(21)", 0.76, 2.11, False),
    ("(22)", 0.88, 2.09, False),
    ("(22)", 1.27, 2.09, False),
    ("(22)", 1.26, 2.09, False),
    ("(22)", 12.28, 7.8, False),
    ("(24)", 2.51, 0.133, False),
    ("(24)", 15.0, 7.8, False),
    ("(25)", 2.91, 0.195, False),
    ("(25)", 0.323, 0.195, False),
    ("(26)", 11.64, 11.81, True),
    ("(26)", 11.64, 5.72, False),
    ("(27)", 0.895, 0.9, True),
    ("(27)", 2.113, 2.122, True),
    ("(28)", 5.63, 1.7, False),
    ("(29)", 2.68, 0.563, False),
    ("(30)", 5.80, 5.8, True),
    ("(31)", 6.60, 6.6, True),
]


@pytest.mark.parametrize(("row", "expected"), list(zip(what_follows(), EXPECTED, strict=True)))
def test_what_follows_from_the_selection(row, expected):
    equation, gives, implied, follows = expected
    assert row.equation == equation
    for value, printed in ((row.gives, gives), (row.implied, implied)):
        digits = len(str(printed).partition(".")[2])
        assert value == pytest.approx(printed, abs=0.5001 * 10.0**-digits)
    assert row.follows is follows


def test_boundary_condition_contradicts_the_published_peak():
    condition = boundary_condition()
    assert condition.V1 == pytest.approx(10.45, abs=5e-3)
    assert math.degrees(condition.largest_angle) == pytest.approx(98.3, abs=0.05)
    # At 7.8 rad/s the pendulum reaches half of theta_0 by t3, and P3 = 0.563 takes it back too far.
    assert math.degrees(condition.reached) == pytest.approx(30.4, abs=0.05)
    profile = seven_phases(TABLE_1, 7.8, selection.P2)
    P3 = selection.eq_23_p3(selection.eq_27_p2())
    assert condition.drift == pytest.approx((P3 - profile.restoring_speed) * 4.9, rel=1e-9)
    assert math.degrees(condition.drift) == pytest.approx(29.4, abs=0.05)
