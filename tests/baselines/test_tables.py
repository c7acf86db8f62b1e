"""The printing of bounds; the tables have examples."""

from __future__ import annotations

import math

import pytest

from baselines.tables import printed_above, printed_below


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
