"""Logs of a rig: reading, and their checks."""

import csv
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.checks import nearest, require
from capsule_gym.core import _core
from capsule_gym.tasks.task import THETA_LIMIT

UNITS = {"t": "s", "torque": "N m", "theta": "rad", "theta_dot": "rad/s", "x": "m", "x_dot": "m/s"}
# Largest plausible sizes, shortest and longest log, s, and its largest number of rows: memory grows
# with their product.
LARGEST = {
    "torque": 20.0,
    "theta": 1.2 * THETA_LIMIT,
    "theta_dot": 1.5 * _core.THETA_DOT_BOUND,
    "x_dot": 4.0,
    "x": 1e3,
}
SHORTEST, LONGEST, MOST_ROWS = 2.0, 100.0, 100_000


def read_log(log: Any) -> dict[str, np.ndarray]:
    """The columns of a log, float64, with NaN where a reading is missing, after all checks of
    `identify`.
    """
    if isinstance(log, (str, os.PathLike)):
        try:
            # Spreadsheets write a mark in front of the first name.
            lines = Path(log).read_text(encoding="utf-8-sig").splitlines()
        except UnicodeDecodeError:
            raise ValueError(
                f"log must be a CSV file in UTF-8, got {str(log)!r} in another encoding"
            ) from None
        reader = csv.DictReader(filter(str.strip, lines), skipinitialspace=True)
        rows, names = list(reader), reader.fieldnames or []
        require(len({*names}) == len(names), "log", "of columns with different names", names)
        for row in rows:
            require(
                None not in row,
                "a row of log",
                f"of one number for each of {[*row][:-1]}",
                [*row.values()],
            )
        log = {name: [row[name] or "nan" for row in rows] for name in (rows[0] if rows else {})}
    require(
        isinstance(log, Mapping),
        "log",
        "the path of a CSV file or a mapping of columns",
        log,
        TypeError,
    )
    columns: dict[str, np.ndarray] = {}
    for name, values in log.items():
        where, exact = f"column {name!r}", name in ("t", "torque")
        if name not in UNITS:
            raise ValueError(
                f"log must have columns out of {tuple(UNITS)}, got {name!r}{nearest(str(name), UNITS)}"
            )
        try:
            column = columns[name] = np.array(values, np.float64, ndmin=1)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(
                f"{where} must contain numbers ({UNITS[name]}) only: {error}"
            ) from None
        expected = (len(next(iter(columns.values()))),)
        require(column.shape == expected, where, "one number for each row", column.shape)
        lost = np.isnan(column)
        broken = np.isinf(column).any() or (lost.any() and exact) or (lost.size and lost.all())
        accepted = (
            "finite numbers" if exact else "finite numbers, or NaN for a lost reading, not all"
        )
        require(not broken, where, accepted, column)
        largest, limit = float(np.nanmax(np.abs(column), initial=0.0)), LARGEST.get(name, math.inf)
        require(largest <= limit, where, f"in {UNITS[name]}, within +-{limit:g}", largest)
    complete = {"t", "torque"} <= set(columns) and bool({"theta", "theta_dot"} & set(columns))
    require(
        complete, "log", "of the columns 't', 'torque', and 'theta' or 'theta_dot'", tuple(columns)
    )
    t, torque, dt = columns["t"], columns["torque"], np.diff(columns["t"])
    period = float(dt.mean()) if len(dt) else 0.0
    equal = 1e-4 <= period <= 0.05 and bool((np.abs(dt - period) <= 0.05 * period).all())
    accepted = (
        f"in equal steps of 0.0001 to 0.05 s, over at least {SHORTEST:g} s and at most {LONGEST:g} s, in at most "
        f"{MOST_ROWS} rows"
    )
    worst = int(np.abs(dt - period).argmax()) if len(dt) else 0
    found = (
        f"{len(t)} rows over {dt.sum():g} s; the step after row {worst} is {dt[worst : worst + 1]}"
    )
    require(
        equal and SHORTEST <= dt.sum() <= LONGEST and len(t) <= MOST_ROWS,
        "column 't'",
        accepted,
        found,
    )
    require(np.ptp(torque) > 1e-6 * np.abs(torque).max(), "column 'torque'", "varied (N m)", torque)
    for place, rate in (("theta", "theta_dot"), ("x", "x_dot")):
        if place not in columns or rate not in columns:
            continue
        # The change of a position over 0.1 s against the mean rate: one scale for both, or the
        # units differ.
        width = max(1, round(0.1 / period))
        known = np.isfinite(columns[rate])
        filled = np.interp(t, t[known], columns[rate][known])
        mean = np.convolve(filled, np.ones(width) / width, "valid")[:-1]
        change = (columns[place][width:] - columns[place][:-width]) / (width * period)
        both = np.isfinite(change)
        # Where noise dominates, the scales tell nothing.
        sizes = np.std([change[both], mean[both]], axis=1) if both.any() else np.ones(2)
        ratio = sizes[0] / max(sizes[1], 1e-12)
        if (
            not 0.5 < ratio < 2.0
            and sizes.all()
            and np.corrcoef(change[both], mean[both])[0, 1] > 0.9
        ):
            raise ValueError(
                f"column {rate!r} must be the derivative of column {place!r}, in {UNITS[rate]} and {UNITS[place]}: "
                f"changes of {place} are {ratio:.3g} times the integral of {rate}"
            )
    return columns
