"""The parameter selection (20) to (31), by hand and compared with Table 1."""

import pytest

from baselines.paper import selection

# Equation, given and implied value of each row, to half a unit of the last given digit, and whether one follows.
EXPECTED = [
    ("(21)", "0.76", "2.11", False), ("(22)", "0.88", "2.09", False), ("(22)", "1.27", "2.09", False),
    ("(22)", "1.26", "2.09", False), ("(23)", "0.53", "1.05", False), ("(24)", "2.51", "0.133", False),
    ("(25)", "2.91", "0.195", False), ("(25)", "0.323", "0.195", False), ("(26)", "11.64", "11.81", True),
    ("(27)", "0.895", "0.9", True), ("(27)", "2.113", "2.122", True), ("(28)", "5.63", "1.7", False),
    ("(29)", "2.68", "0.563", False), ("(30)", "5.80", "5.8", True), ("(31)", "6.60", "6.6", True),
]  # fmt: skip


def test_what_follows_from_the_selection():
    for row, (equation, gives, implied, follows) in zip(selection.evaluate_selection(), EXPECTED, strict=True):
        assert row["equation"] == equation
        for value, printed in ((row["gives"], gives), (row["implied"], implied)):
            assert value == pytest.approx(float(printed), abs=0.5001 * 10.0 ** -len(printed.partition(".")[2]))
        assert row["follows"] is follows
