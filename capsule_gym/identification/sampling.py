"""How a log was sampled: uneven times, lost rows, and sensors that repeat readings."""

from typing import Any

import numpy as np

from capsule_gym.checks import check_number, require
from capsule_gym.identification.log import (
    LONGEST_PERIOD,
    MOST_ROWS,
    SHORTEST_PERIOD,
    UNITS,
    read_columns,
)

# Repeated readings by which a sensor exceeds what its resolution explains.
MOST_REPEATS = 10


def on_grid(log: Any, period: float) -> dict[str, np.ndarray]:
    """Puts the rows of a log on a grid of equal steps, for `identify`.

    Each row belongs to the nearest time of the grid, which follows the log's clock. Readings of
    times without a row are lost; their torque is interpolated.

    Args:
        log: as for `identify`, with times that may be uneven and rows that may be missing.
        period: the period of the log, s.

    Returns:
        The columns, float64.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is invalid, or the times of two rows are the same in the grid.

    Examples:
        >>> log = {"t": [0.0, 0.0102, 0.0298], "torque": [0.1, 0.2, 0.4], "theta": [0.0, 0.1, 0.2]}
        >>> on_grid(log, 0.01)["theta"]
        array([0. , 0.1, nan, 0.2])
    """
    columns = read_columns(log)
    accepted = f"a number of s from {SHORTEST_PERIOD} to {LONGEST_PERIOD}"
    period = check_number("period", period, accepted, SHORTEST_PERIOD, LONGEST_PERIOD)
    require({"t", "torque"} <= set(columns), "log", "of 't', 'torque' and others", [*columns])
    t = columns["t"]
    steps = np.round(np.diff(t) / period)
    apart = len(t) > 1 and bool((steps > 0.0).all())
    require(apart, "column 't'", f"rising by about {period:g} s or more in each row", t)
    require(steps.sum() < MOST_ROWS, "column 't'", f"of at most {MOST_ROWS} periods", steps.sum())
    places = np.append(0, np.cumsum(steps)).astype(int)
    grid = np.arange(places[-1] + 1)
    found = {"t": np.polyval(np.polyfit(places, t, 1), grid)}
    found["torque"] = np.interp(grid, places, columns["torque"])
    for name, values in columns.items():
        if name not in found:
            found[name] = np.full(len(grid), np.nan)
            found[name][places] = values
    return found


def drop_repeats(columns: dict[str, np.ndarray]) -> dict[str, int]:
    """Replaces readings that a sensor repeats by NaN.

    Repeats that follow from the sensor's resolution are readings, as are those of a rig before its
    first torque and of a platform whose velocity is exactly 0, in a log without noise.

    Returns:
        The number of repeats by sensor.

    Raises:
        ValueError: if a sensor has the same reading everywhere.
    """
    torque = columns["torque"]
    moving = np.cumsum(torque != torque[0]) > 0
    slipping = ~rests(columns["x_dot"]) if "x_dot" in columns else moving
    found = {}
    for name in UNITS:
        if name in ("t", "torque") or name not in columns:
            continue
        readings = columns[name]
        varied = np.nanmax(readings) > np.nanmin(readings)
        accepted = "of a sensor that works: leave the cells empty or the column out"
        require(varied, f"column {name!r}", accepted, readings)
        repeated = held(readings) & moving
        if name in ("x", "x_dot"):
            repeated &= slipping
        if repeated.sum() > MOST_REPEATS:
            found[name] = int(repeated.sum())
            columns[name] = np.where(repeated, np.nan, readings)
    return found


def rests(x_dot: np.ndarray) -> np.ndarray:
    """Whether a platform rests, in a log without noise: it returns to exactly the same velocity."""
    repeated = np.diff(x_dot, prepend=np.nan) == 0.0
    begins = repeated & ~np.append(False, repeated[:-1])
    values, counts = np.unique(x_dot[begins], return_counts=True)
    returns = values[counts > 1]
    return np.isin(x_dot, np.append(returns, 0.0))


def held(readings: np.ndarray) -> np.ndarray:
    """Whether a reading is that of the row before, for another reason than its resolution.

    With a resolution, readings change as often by one step as they stay, or they stay where they
    change by one step.
    """
    changes = np.abs(np.diff(readings, prepend=np.nan))
    repeated = changes == 0.0
    moved = changes[changes > 0.0]
    step = 1.5 * moved.min(initial=np.inf)
    by_resolution = np.sum(moved < step)
    following = changes[1:][repeated[:-1] & (changes[1:] > 0.0)]
    slow = len(following) > 0 and np.median(following) < step
    if slow or repeated.sum() < 2.0 * by_resolution:
        repeated[:] = False
    return repeated
