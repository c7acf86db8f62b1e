"""Tables and the printing of bounds."""

from __future__ import annotations

import math

import pytest

from baselines.tables import markdown_table, printed_above, printed_below, text_table

ROWS = [["name", "speed\ncm/s", "remark"], ["proposed", "1.38", "slow"], ["EPC", "11.6", ""]]


def test_columns_are_aligned_and_numbers_in_cells_stay_as_they_are():
    lines = text_table(ROWS, left=1).splitlines()
    column = lines[0].index("speed") + len("speed")
    assert [line[:column].endswith(cell) for line, cell in zip(lines[3:], ("1.38", "11.6"), strict=True)] == [True] * 2
    assert all(line == line.rstrip() for line in lines)
    left = text_table(ROWS).splitlines()
    assert left[3].index("1.38") == left[4].index("11.6")
    right = text_table([["a", "b"], ["x", "1e3"], ["y", "10"]], left=1, last_left=False).splitlines()
    assert right[2].rindex("3") == right[3].rindex("0")
    assert markdown_table([["a", "b"], ["007", "x"]]).splitlines()[-1].split() == ["|", "007", "|", "x", "|"]


@pytest.mark.parametrize(
    ("value", "digits", "below", "above"),
    [
        (0.8477, 3, "0.847", "0.848"),
        (5.8037, 2, "5.80", "5.81"),
        (0.5, 1, "0.5", "0.5"),
        (77.94, 0, "77", "78"),
        (-1.234, 2, "-1.24", "-1.23"),
        (2.0, 3, "2.000", "2.000"),
        (math.nextafter(0.25, 1.0), 2, "0.25", "0.26"),
    ],
)
def test_bounds_are_rounded_outwards(value, digits, below, above):
    assert (printed_below(value, digits), printed_above(value, digits)) == (below, above)
    assert float(below) <= value <= float(above)
