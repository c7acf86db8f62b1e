"""The reference that the control laws track: the profile, and the motion of the nominal platform along it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from baselines.laws.profiles import Profile
from capsule_gym import dynamics
from capsule_gym.checks import check_number
from capsule_gym.compilation import cached_entry, jitable
from capsule_gym.config import LAW_DT
from capsule_gym.layout import record
from capsule_gym.parameters import Plant

# The nominal platform is integrated in steps of about this length, s; the error is then below 1e-8 m.
FINE_DT = 2e-5

COLUMNS = ("theta_d", "theta_d_dot", "theta_d_ddot", "x_d", "x_d_dot", "x_d_ddot", "cycle_start")


@jitable
def slide(
    force: float, forwards: float, backwards: float, static_ratio: float, total: float, x: float, x_dot: float, h: float
) -> tuple[float, float, float]:
    """Moves a platform under a constant force for h seconds, through a stop within this time.

    Args:
        force: the pendulum's push, N.
        forwards: kinetic friction while it slides forwards, N.
        backwards: kinetic friction while it slides backwards, N.
        static_ratio: static over kinetic friction.
        total: M + m, kg.
        x: m.
        x_dot: m/s; exactly 0.0 in stick.
        h: s.

    Returns:
        x and x_dot afterwards, and x'' at the start in m/s^2.
    """
    initial = 0.0
    remaining = h
    # At most two parts: the slide until the platform stops, and the motion from rest.
    for piece in range(2):
        at_rest = x_dot == 0.0
        forward = force > 0.0 if at_rest else x_dot > 0.0
        friction = forwards if forward else backwards
        if at_rest and abs(force) <= static_ratio * friction:
            break
        x_ddot = (force - friction if forward else force + friction) / total
        if piece == 0:
            initial = x_ddot
        after = x_dot + remaining * x_ddot
        if x_dot * after >= 0.0:
            x += remaining * (x_dot + 0.5 * remaining * x_ddot)
            x_dot = after
            break
        x -= 0.5 * x_dot * x_dot / x_ddot
        remaining += x_dot / x_ddot
        x_dot = 0.0
    return x, x_dot, initial


def platform_motion(
    angle: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, h: float, p: Plant
) -> np.ndarray:
    """x, x' and x'' of the platform while the pendulum follows a prescribed motion: the second row of Eq. (1).

    The pendulum's angle (rad), velocity and acceleration are given at every h seconds, shape (n,).

    Returns:
        Shape (3, n), from rest at x = 0: m, m/s, m/s^2.
    """
    motion, numbers = np.zeros((3, len(angle))), "float64[::1]"
    angle, velocity, acceleration = map(np.ascontiguousarray, (angle, velocity, acceleration))
    signature = f"void({numbers}, {numbers}, {numbers}, float64, {numbers}, float64[:, ::1])"
    cached_entry(_write_motion, signature).call(angle, velocity, acceleration, h, np.array(p), motion)
    return motion


def _write_motion(
    angle: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    h: float,
    plant: np.ndarray,  # the numbers of a `Plant`
    motion: np.ndarray,  # written: what `platform_motion` returns
) -> None:
    p = record(plant, 0, Plant)
    total = p.M + p.m
    x = x_dot = 0.0
    for n in range(len(angle)):
        force = dynamics.driving_force(angle[n], velocity[n], acceleration[n], p)
        normal = max(0.0, dynamics.normal_force(angle[n], velocity[n], acceleration[n], p))
        forwards = dynamics.kinetic_friction(1.0, p) * normal
        backwards = dynamics.kinetic_friction(-1.0, p) * normal
        motion[0, n], motion[1, n] = x, x_dot
        x, x_dot, motion[2, n] = slide(force, forwards, backwards, p.static_ratio, total, x, x_dot, h)


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
