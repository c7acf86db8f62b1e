"""The measures of an episode as tables show them: labels, units, digits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Measure:
    """A metric as a column or row of a table.

    Attributes:
        metric: its name in results.
        label: its name in tables, with the unit.
        digits: decimals.
    """

    metric: str
    label: str
    digits: int

    def format(self, value: float | None, *, sign: bool = False) -> str:
        """The number; an infinite or undefined one as the dash that says 'no forward progress'."""
        if value is None or not math.isfinite(value):
            return "-"
        text = f"{value:{'+' if sign else ''}.{self.digits}f}"
        return text.replace("-", "") if float(text) == 0.0 else text

    def with_interval(self, summary: Mapping[str, Any], *, sign: bool = False) -> str:
        """`value [low, high]` from `{"iqm": .., "low": .., "high": ..}`; the value alone where there is no interval."""
        value = self.format(summary["iqm"], sign=sign)
        low, high = (self.format(summary[end], sign=sign) for end in ("low", "high"))
        return value if low == high == "-" else f"{value} [{low}, {high}]"


MEASURES = {
    measure.metric: measure
    for measure in (
        Measure("mean_speed", "mean speed (cm/s)", 2),
        Measure("cost_of_transport", "cost of transport", 2),
        Measure("peak_torque", "peak torque (N m)", 3),
        Measure("rms_torque", "rms torque (N m)", 3),
        Measure("backward_ratio", "backward / forward travel", 3),
        Measure("stuck_fraction", "fraction of time stuck", 3),
    )
}

# Stands in the results of the sets whose plants all lie within the grid of optima.
SHARE = Measure("share_of_optimum", "share of optimum", 2)
