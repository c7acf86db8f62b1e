"""The profile (9) as printed and the parameter selection (20) to (31), by hand and compared with Table 1."""

import math

import pytest

from baselines.laws.profiles import PROPOSED
from baselines.paper import selection


def test_printed_profile_by_hand():
    phases = {phase["name"]: phase for phase in selection.printed_profile()}
    P3 = PROPOSED.restoring_speed
    # IV: (t3 - t) / (t3 - t2) P2 falls from 0 to -0.63 / 0.075 P2.
    assert phases["IV"]["printed"] == pytest.approx((0.0, -0.63 / 0.075 * 2.122, -0.5 * 0.63 * 0.63 / 0.075 * 2.122))
    # V: (t3 - t) / (t4 - t3) P3 falls from -P3 to -1.43 / 0.63 P3; VII rises from 0 to 0.8 / 4.1 P3.
    assert phases["V"]["printed"][:2] == pytest.approx((-P3, -1.43 / 0.63 * P3))
    assert phases["VII"]["printed"][1] == pytest.approx(0.8 / 4.1 * P3)
    # Neither continuous nor closed.
    (_, two, _), (three, _, _) = phases["II"]["printed"], phases["III"]["printed"]
    assert abs(three - two) > 1.0
    assert math.degrees(sum(phase["printed"][2] for phase in phases.values())) == pytest.approx(-378, abs=0.5)


# Given and implied values of each row, to half a unit of the last given digit.
EXPECTED = [
    ("(21)", "0.76", "2.11", False),
    ("(22)", "0.88", "2.09", False),
    ("(22)", "1.27", "2.09", False),
    ("(22)", "1.26", "2.09", False),
    ("(23)", "0.53", "1.05", False),
    ("(24)", "2.51", "0.133", False),
    ("(25)", "2.91", "0.195", False),
    ("(25)", "0.323", "0.195", False),
    ("(26)", "11.64", "11.81", True),
    ("(27)", "0.895", "0.9", True),
    ("(27)", "2.113", "2.122", True),
    ("(28)", "5.63", "1.7", False),
    ("(29)", "2.68", "0.563", False),
    ("(30)", "5.80", "5.8", True),
    ("(31)", "6.60", "6.6", True),
]


def test_what_follows_from_the_selection():
    for row, (equation, gives, implied, follows) in zip(selection.evaluate_selection(), EXPECTED, strict=True):
        assert row["equation"] == equation
        for value, printed in ((row["gives"], gives), (row["implied"], implied)):
            assert value == pytest.approx(float(printed), abs=0.5001 * 10.0 ** -len(printed.partition(".")[2]))
        assert row["follows"] is follows
