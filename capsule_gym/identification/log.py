"""Logs of a rig: reading, and their checks."""

import csv
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.checks import as_floats, nearest, require
from capsule_gym.core import _core
from capsule_gym.tasks.task import THETA_LIMIT

UNITS = {"t": "s", "torque": "N m", "theta": "rad", "theta_dot": "rad/s", "x": "m", "x_dot": "m/s"}
# Largest plausible sizes.
LARGEST = {
    "torque": 20.0,
    "theta": 1.2 * THETA_LIMIT,
    "theta_dot": 1.5 * _core.THETA_DOT_BOUND,
    "x_dot": 4.0,
    "x": 1e3,
}
# Shortest and longest log, s, and its largest number of rows: memory grows with their product.
SHORTEST = 2.0
LONGEST = 100.0
MOST_ROWS = 100_000
# Shortest and longest period, s, and the largest share of it by which a step may differ.
SHORTEST_PERIOD = 1e-4
LONGEST_PERIOD = 0.05
UNEVEN = 0.05
# Angle, rad, near which a pendulum that stays for so long, s, lies on its stop.
NEAR_STOP = 1.4
REST = 0.3


def read_log(log: Any) -> dict[str, np.ndarray]:
    """The columns of a log, float64, with NaN where a reading is missing.

    Raises:
        TypeError: if the log is neither a path nor a mapping.
        ValueError: if it is invalid; the message names the column.
    """
    columns = read_columns(log)
    angle = "theta" in columns or "theta_dot" in columns
    complete = "t" in columns and "torque" in columns and angle
    required = "of the columns 't', 'torque', and 'theta' or 'theta_dot'"
    require(complete, "log", required, tuple(columns))
    period = check_times(columns["t"])
    torque = columns["torque"]
    varied = np.ptp(torque) > 1e-6 * np.abs(torque).max()
    require(varied, "column 'torque'", "varied (N m)", torque)
    for place, rate in (("theta", "theta_dot"), ("x", "x_dot")):
        if place in columns and rate in columns:
            check_rate(columns, place, rate, period)
    if "theta" in columns:
        check_stop(columns["theta"], period)
    return columns


def read_columns(log: Any) -> dict[str, np.ndarray]:
    """The columns of a log, each of plausible numbers, before their comparison."""
    if isinstance(log, (str, os.PathLike)):
        log = read_csv(log)
    elif hasattr(log, "columns"):
        # A DataFrame is no mapping.
        log = {name: log[name] for name in log.columns}
    mapping = isinstance(log, Mapping)
    require(mapping, "log", "the path of a CSV file or a mapping of columns", log, TypeError)
    columns: dict[str, np.ndarray] = {}
    for name, values in log.items():
        if name not in UNITS:
            similar = nearest(str(name), UNITS)
            raise ValueError(f"log must have columns out of {tuple(UNITS)}, got {name!r}{similar}")
        columns[name] = check_column(name, values)
        rows = len(next(iter(columns.values())))
        shape = columns[name].shape
        require(shape == (rows,), f"column {name!r}", "one number for each row", shape)
        check_size(name, columns[name])
    return columns


def read_csv(path: str | os.PathLike[str]) -> dict[str, list[str]]:
    """The columns of a CSV file as texts, with nan where a cell is empty."""
    try:
        # Spreadsheets write a mark in front of the first name.
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError(
            f"log must be a CSV file in UTF-8, got {str(path)!r} in another encoding"
        ) from None
    reader = csv.DictReader(filter(str.strip, lines), skipinitialspace=True)
    rows = list(reader)
    names = reader.fieldnames or []
    different = len({*names}) == len(names)
    require(different, "log", "of columns with different names", names)
    for row in rows:
        # DictReader puts further cells under None.
        accepted = f"of one number for each of {[*row][:-1]}"
        require(None not in row, "a row of log", accepted, [*row.values()])
    return {name: [row[name] or "nan" for row in rows] for name in names if rows}


def check_column(name: str, values: Any) -> np.ndarray:
    """Returns a column as an array, with NaN where it is masked, or raises an error."""
    try:
        return np.atleast_1d(as_floats(values))
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"column {name!r} must contain numbers ({UNITS[name]}) only: {error}"
        ) from None


def check_size(name: str, column: np.ndarray) -> None:
    """Raises an error unless a column's numbers are plausible, and finite or lost readings."""
    where = f"column {name!r}"
    lost = np.isnan(column)
    if name in ("t", "torque"):
        accepted = "finite numbers"
        missing = lost.any()
    else:
        accepted = "finite numbers, or NaN for a lost reading, not all"
        missing = lost.size and lost.all()
    infinite = np.isinf(column).any()
    require(not (missing or infinite), where, accepted, column)
    largest = float(np.nanmax(np.abs(column), initial=0.0))
    limit = LARGEST.get(name, math.inf)
    accepted = f"in {UNITS[name]}, within +-{limit:g}"
    require(largest <= limit, where, accepted, largest)


def check_times(t: np.ndarray) -> float:
    """Returns the period of a log, s, or raises an error."""
    steps = np.diff(t)
    duration = steps.sum()
    period = float(steps.mean()) if len(steps) else 0.0
    deviations = np.abs(steps - period)
    worst = int(deviations.argmax()) if len(steps) else 0
    equal = bool((deviations <= UNEVEN * period).all())
    fits = equal and SHORTEST_PERIOD <= period <= LONGEST_PERIOD
    periods = f"{SHORTEST_PERIOD} to {LONGEST_PERIOD} s"
    durations = f"at least {SHORTEST:g} s and at most {LONGEST:g} s"
    steps_accepted = f"in equal steps of {periods} (capsule_gym.identification.on_grid makes them)"
    accepted = f"{steps_accepted}, over {durations}, in at most {MOST_ROWS} rows"
    step = steps[worst : worst + 1]
    found = f"{len(t)} rows over {duration:g} s; the step after row {worst} is {step}"
    bounded = SHORTEST <= duration <= LONGEST and len(t) <= MOST_ROWS
    require(fits and bounded, "column 't'", accepted, found)
    return period


def check_rate(columns: Mapping[str, np.ndarray], place: str, rate: str, period: float) -> None:
    """Raises an error where a rate is not the derivative of a position, in the same unit.

    The change of the position over 0.1 s is compared with the mean rate.
    """
    t = columns["t"]
    position = columns[place]
    speed = columns[rate]
    width = max(1, round(0.1 / period))
    known = np.isfinite(speed)
    filled = np.interp(t, t[known], speed[known])
    mean = np.convolve(filled, np.ones(width) / width, "valid")[:-1]
    moved = position[width:] - position[:-width]
    change = moved / (width * period)
    both = np.isfinite(change)
    change, mean = change[both], mean[both]
    if not both.any() or not change.std() or not mean.std():
        return
    ratio = change.std() / max(mean.std(), 1e-12)
    # Where noise dominates, the scales tell nothing.
    if not 0.5 < ratio < 2.0 and np.corrcoef(change, mean)[0, 1] > 0.9:
        units = f"{UNITS[rate]} and {UNITS[place]}"
        found = f"changes of {place} are {ratio:.3g} times the integral of {rate}"
        raise ValueError(
            f"column {rate!r} must be the derivative of column {place!r}, in {units}: {found}"
        )


def check_stop(theta: np.ndarray, period: float) -> None:
    """Raises an error where the pendulum meets its stop, or lies on it."""
    stopped = np.abs(theta) >= THETA_LIMIT
    # The readings of a stop may have a bias.
    near = np.abs(theta) > NEAR_STOP
    width = math.ceil(REST / period)
    rests = np.convolve(near, np.ones(width), "valid") > width - 0.5
    stopped[: len(rests)] |= rests
    if stopped.any():
        row = int(stopped.argmax())
        raise ValueError(
            "column 'theta' must be of a pendulum that stays away from its stop at 90 deg, got "
            f"{theta[row]:.3f} rad in row {row}: cut the log there"
        )
