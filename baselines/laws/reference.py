"""The reference that the control laws track: the profile, and the motion of the nominal platform along it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from baselines.laws.profiles import Profile
from capsule_gym import _core, native
from capsule_gym.checks import check_number
from capsule_gym.config import LAW_DT
from capsule_gym.parameters import Plant

# The nominal platform is integrated in steps of about this length, s; the error is then below 1e-8 m.
FINE_DT = 2e-5

COLUMNS = ("theta_d", "theta_d_dot", "theta_d_ddot", "x_d", "x_d_dot", "x_d_ddot", "cycle_start")


def platform_motion(
    angle: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, h: float, p: Plant
) -> np.ndarray:
    """x, x' and x'' of the platform while the pendulum follows a prescribed motion: the second row of Eq. (1).

    The pendulum's angle (rad), velocity and acceleration are given at every h seconds, shape (n,).

    Returns:
        Shape (3, n), from rest at x = 0: m, m/s, m/s^2.
    """
    motion, plant = np.zeros((3, len(angle))), native.ordered(_core.PLANT, p._asdict())
    arrays = (np.ascontiguousarray(values, np.float64) for values in (angle, velocity, acceleration))
    native.call("platform_motion", *arrays, len(angle), float(h), plant, motion)
    return motion


@lru_cache(maxsize=16)
def reference_table(profile: Profile, nominal: Plant, dt: float = LAW_DT) -> np.ndarray:
    """One cycle of a profile, whose period must be a multiple of the law's, dt in s; x_d is the nominal platform's.

    Returns:
        Shape (steps, 7), float64, columns COLUMNS; read-only.

    Raises:
        TypeError: if dt is not a number.
        ValueError: if dt is not positive, or the profile's period is not a multiple of it.
    """
    dt = check_number("dt", dt, "a finite number > 0 (s)", 0.0, open_low=True)
    steps = round(profile.period / dt)
    if abs(steps * dt - profile.period) > 1e-9:
        raise ValueError(f"the profile's period must be a multiple of dt = {dt!r} s, got {profile.period!r} s")
    fine = max(1, round(dt / FINE_DT))
    h = dt / fine
    # Sampled at the middle of the fine steps, where the jumps of theta_d'' at the edges of the phases do not lie.
    angle, velocity, acceleration = profile.evaluate((np.arange(steps * fine) + 0.5) * h)
    platform = platform_motion(angle, velocity, acceleration, h, nominal)[:, ::fine]
    table = np.zeros((steps, len(COLUMNS)))
    table[:, :3] = np.stack(profile.evaluate(np.arange(steps) * dt), axis=1)
    table[:, 3:6] = platform.T
    table[0, 6] = 1.0
    table.setflags(write=False)
    return table
