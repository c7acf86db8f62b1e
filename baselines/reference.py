"""The reference that the control laws track: the profile, and the motion of the nominal platform along it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from baselines.profiles import Profile
from capsule_gym import dynamics
from capsule_gym.controller import LAW_DT
from capsule_gym.kernels import compile_cached
from capsule_gym.parameters import Plant

# The nominal platform is integrated in this many steps per step of the law; the error is then below 1e-8 m.
FINE = 50

COLUMNS = ("theta_d", "theta_d_dot", "theta_d_ddot", "x_d", "x_d_dot", "x_d_ddot", "cycle_start")


def platform_motion(
    angle: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, h: float, p: Plant
) -> np.ndarray:
    """x, x' and x'' of the platform while the pendulum follows a prescribed motion: the second row of Eq. (1).

    Args:
        angle: theta at every h seconds, rad, shape (n,).
        velocity: theta', rad/s.
        acceleration: theta'', rad/s^2.
        h: s.
        p: the plant.

    Returns:
        Shape (3, n), from rest at x = 0: m, m/s, m/s^2.
    """
    motion = np.zeros((3, len(angle)))
    total = p.M + p.m
    x = x_dot = 0.0
    for n in range(len(angle)):
        force = dynamics.driving_force(angle[n], velocity[n], acceleration[n], p)
        normal = max(0.0, dynamics.normal_force(angle[n], velocity[n], acceleration[n], p))
        if x_dot == 0.0:
            slip = 1.0 if force > 0.0 else -1.0
            if abs(force) <= p.static_ratio * dynamics.kinetic_friction(slip, p) * normal:
                slip = 0.0
        else:
            slip = 1.0 if x_dot > 0.0 else -1.0
        x_ddot = 0.0
        if slip != 0.0:
            x_ddot = (force - slip * dynamics.kinetic_friction(slip, p) * normal) / total
        motion[0, n], motion[1, n], motion[2, n] = x, x_dot, x_ddot
        after = x_dot + h * x_ddot
        if x_dot * after < 0.0:
            # Stops inside the step; what is left of it begins at rest.
            tau = -x_dot / x_ddot
            x += 0.5 * tau * x_dot
            x_dot = 0.0
            slip = 1.0 if force > 0.0 else -1.0
            friction = dynamics.kinetic_friction(slip, p) * normal
            if abs(force) > p.static_ratio * friction:
                x_dot = (h - tau) * (force - slip * friction) / total
                x += 0.5 * (h - tau) * x_dot
        else:
            x += h * x_dot + 0.5 * h * h * x_ddot
            x_dot = after
    return motion


@lru_cache(maxsize=1)
def _platform_motion() -> Any:
    """The function above, compiled."""
    return compile_cached(platform_motion)


@lru_cache(maxsize=16)
def reference_table(profile: Profile, nominal: Plant) -> np.ndarray:
    """One cycle at the law's rate.

    Args:
        profile: what the pendulum is to follow; its period must be a multiple of 1 ms.
        nominal: the plant that the controller believes in.

    Returns:
        Shape (steps, 7), float64, columns COLUMNS; read-only.

    Raises:
        ValueError: if the period is no multiple of the law's step.
    """
    steps = round(profile.period / LAW_DT)
    if abs(steps * LAW_DT - profile.period) > 1e-9:
        raise ValueError(f"the profile's period must be a multiple of {LAW_DT} s, got {profile.period!r} s")
    h = LAW_DT / FINE
    # Sampled at the middle of the fine steps, where the jumps of theta_d'' at the edges of the phases do not lie.
    angle, velocity, acceleration = profile.evaluate((np.arange(steps * FINE) + 0.5) * h)
    platform = _platform_motion()(angle, velocity, acceleration, h, nominal)[:, ::FINE]
    table = np.zeros((steps, len(COLUMNS)))
    table[:, :3] = np.stack(profile.evaluate(np.arange(steps) * LAW_DT), axis=1)
    table[:, 3:6] = platform.T
    table[0, 6] = 1.0
    table.setflags(write=False)
    return table
