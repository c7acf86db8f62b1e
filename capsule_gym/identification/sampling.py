"""How a log was sampled: sensors that repeat readings."""

import numpy as np

from capsule_gym.checks import require
from capsule_gym.identification.log import UNITS

# Repeated readings by which a sensor exceeds what its resolution explains.
MOST_REPEATS = 10


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
    slipping = columns["x_dot"] != 0.0 if "x_dot" in columns else moving
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
