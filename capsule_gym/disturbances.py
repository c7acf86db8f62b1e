"""Disturbances of sensors, motor and platform, compiled; `kernels.step` calls them where plants are varied.

`parameters.Disturbances` documents them. The history, the last `StepSettings.history` states of each environment
as (theta, theta_dot, x_dot), ends a block of `world`. The random numbers are hashes of the episode's key and a counter
(Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014), so that a reading is the same alone and
in a batch.
"""

from __future__ import annotations

import math

import numpy as np

from capsule_gym.compilation import inlined
from capsule_gym.elementary import ROUNDING, bits, decay, normals, scramble, sincos, uniforms
from capsule_gym.layout import AT, HALTED, HISTORY_ROWS, LANES, StepSettings, load, store

# Added to a whole number: the lowest 52 bits of the sum are those of the number.
WHOLE = 2.0**52
# The odd number nearest to 2^64 over the golden ratio; random words of a reading; the factor of the pushes' counter.
_GOLDEN, _WORDS, _PUSHES = np.uint64(0x9E3779B97F4A7C15), np.uint64(8), np.uint64(0x5851F42D4C957F2D)
# Duration of the push in every second, and tolerance of the episode's time, s.
PUSH_TIME, ROUNDING_OF_TIME = 0.1, 1e-9


@inlined
def word_of(key: float, count: float, place: np.uint64) -> np.uint64:
    """One of the eight random words of a reading."""
    return scramble(bits(key) + _GOLDEN * (bits(count + WHOLE) * _WORDS + place))


@inlined
def rounded(value: float, resolution: float) -> float:
    """The multiple of the resolution that is nearest to the value, or the value where the resolution is 0."""
    unit = resolution if resolution > 0.0 else 1.0
    return ((value / unit + ROUNDING) - ROUNDING) * unit if resolution > 0.0 else value


@inlined
def time_between_readings(settings: StepSettings) -> float:
    """The time between readings, s: the period of the law, or without a law the agent's step."""
    period = settings.physics_steps * settings.physics_dt
    return period if settings.with_reference else period * settings.law_steps


@inlined
def begin(block: np.ndarray, n: int, settings: StepSettings) -> None:
    """Sets the drawn constants of the plants that begin an episode, and fills their history."""
    past = block.size - HISTORY_ROWS * LANES * settings.history
    period, pause = settings.physics_steps * settings.physics_dt, time_between_readings(settings)
    for j in range(n):
        if block[AT.active + j] == 0.0:
            continue
        sin, cos = sincos(block[AT.drawn_slope + j])
        m, g, speed = block[AT.drawn_m + j], block[AT.drawn_g + j], block[AT.drawn_stribeck_speed + j]
        static_ratio = block[AT.drawn_static_ratio + j]
        friction = block[AT.drawn_motor_friction + j] + block[AT.motor_friction + j]
        excess, rate = (static_ratio - 1.0, 1.0 / speed) if speed > 0.0 else (0.0, 0.0)
        constants = (
            *(m, block[AT.drawn_l + j], g * cos, block[AT.drawn_k + j], block[AT.drawn_c + j]),
            *(static_ratio, block[AT.drawn_backward_ratio + j], g * sin, block[AT.drawn_viscous + j]),
            *(excess, rate, friction, 0.0),
        )
        store(block, AT.m + j, LANES, constants)
        block[AT.normal_force + j] = (block[AT.M + j] + m) * g * cos
        lag = block[AT.lag + j]
        block[AT.delay + j] = (block[AT.latency + j] / period + ROUNDING) - ROUNDING
        block[AT.drift_share + j] = decay(pause / block[AT.drift_time + j])
        block[AT.motor_share + j] = 1.0 - decay(period / lag) if lag > 0.0 else 1.0
        # The drift begins in its stationary distribution.
        key = block[AT.key + j]
        first, second = normals(word_of(key, 0.0, np.uint64(6)))
        third, _ = normals(word_of(key, 0.0, np.uint64(7)))
        block[AT.drift_of_theta + j] = block[AT.theta_drift + j] * first
        block[AT.drift_of_theta_dot + j] = block[AT.theta_dot_drift + j] * second
        block[AT.drift_of_x_dot + j] = block[AT.x_dot_drift + j] * third
        block[AT.read_x + j] = block[AT.x + j]
        block[AT.readings + j] = block[AT.motor + j] = 0.0
        state = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x_dot + j]
        for entry in range(settings.history):
            store(block, past + HISTORY_ROWS * LANES * entry + j, LANES, state)


@inlined
def drive(block: np.ndarray, j: int, command: float, going: bool, pushes: bool) -> float:
    """The motor's torque in N m from the present command on, and the push on the platform that acts then."""
    motor = block[AT.motor + j]
    command = rounded(command, block[AT.torque_resolution + j])
    share = block[AT.motor_share + j]
    motor += (share if going else 0.0) * (command - motor)
    block[AT.motor + j] = motor
    if not pushes:
        block[AT.push_force + j] = 0.0
        return motor
    time = block[AT.duration + j] + ROUNDING_OF_TIME
    second = np.floor(time)
    since, size = uniforms(scramble(bits(block[AT.key + j]) + _PUSHES * bits(second + WHOLE)))
    since = time - second - (1.0 - PUSH_TIME) * (since - 1.0)
    acts = since >= 0.0 and since < PUSH_TIME
    block[AT.push_force + j] = block[AT.push + j] * (2.0 * size - 3.0) if acts else 0.0
    return motor


@inlined
def remember(block: np.ndarray, n: int, settings: StepSettings) -> None:
    """Writes the present states into the history."""
    cursor = int(block[AT.cursor]) + 1
    cursor = cursor if cursor < settings.history else 0
    block[AT.cursor] = cursor
    here = block.size + HISTORY_ROWS * LANES * (cursor - settings.history)
    for j in range(n):
        state = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x_dot + j]
        store(block, here + j, LANES, state)


@inlined
def read_sensors(block: np.ndarray, n: int, settings: StepSettings) -> None:
    """Takes a reading of every sensor of the environments that take part."""
    past = block.size - HISTORY_ROWS * LANES * settings.history
    cursor = int(block[AT.cursor])
    for j in range(n):
        entry = cursor - int(block[AT.delay + j])
        entry += settings.history if entry < 0 else 0
        state = load(block, max(0, past + HISTORY_ROWS * LANES * entry) + j, LANES, HISTORY_ROWS)
        store(block, AT.late_theta + j, LANES, state)
    pause = time_between_readings(settings)
    for j in range(n):
        # The law is not called any more where the step has ended early.
        halted = settings.with_reference and block[AT.halt + j] == HALTED
        active = block[AT.active + j] != 0.0 and not halted
        key, count = block[AT.key + j], block[AT.readings + j]
        white_0, white_1 = normals(word_of(key, count, np.uint64(0)))
        white_2, slow_2 = normals(word_of(key, count, np.uint64(1)))
        slow_0, slow_1 = normals(word_of(key, count, np.uint64(2)))
        kept = block[AT.drift_share + j]
        new = math.sqrt(1.0 - kept * kept)
        drift_0 = kept * block[AT.drift_of_theta + j] + new * slow_0 * block[AT.theta_drift + j]
        drift_1 = kept * block[AT.drift_of_theta_dot + j] + new * slow_1 * block[AT.theta_dot_drift + j]
        drift_2 = kept * block[AT.drift_of_x_dot + j] + new * slow_2 * block[AT.x_dot_drift + j]
        error_0 = block[AT.theta_bias + j] + drift_0 + white_0 * block[AT.theta_noise + j]
        error_1 = block[AT.theta_dot_bias + j] + drift_1 + white_1 * block[AT.theta_dot_noise + j]
        error_2 = block[AT.x_dot_bias + j] + drift_2 + white_2 * block[AT.x_dot_noise + j]
        theta = rounded(block[AT.late_theta + j] + error_0, block[AT.theta_resolution + j])
        theta_dot = rounded(block[AT.late_theta_dot + j] + error_1, block[AT.theta_dot_resolution + j])
        x_dot = rounded(block[AT.late_x_dot + j] + error_2, block[AT.x_dot_resolution + j])
        theta = theta if settings.with_theta else 0.0
        theta_dot = theta_dot if settings.with_theta_dot else 0.0
        x_dot = x_dot if settings.with_x_dot else 0.0
        x = block[AT.read_x + j] + min(count, 1.0) * pause * x_dot
        block[AT.drift_of_theta + j] = drift_0 if active else block[AT.drift_of_theta + j]
        block[AT.drift_of_theta_dot + j] = drift_1 if active else block[AT.drift_of_theta_dot + j]
        block[AT.drift_of_x_dot + j] = drift_2 if active else block[AT.drift_of_x_dot + j]
        block[AT.read_theta + j] = theta if active else block[AT.read_theta + j]
        block[AT.read_theta_dot + j] = theta_dot if active else block[AT.read_theta_dot + j]
        block[AT.read_x + j] = x if active else block[AT.read_x + j]
        block[AT.read_x_dot + j] = x_dot if active else block[AT.read_x_dot + j]
        block[AT.readings + j] = count + 1.0 if active else count


@inlined
def measure(block: np.ndarray, n: int, settings: StepSettings, begins: bool, last: bool) -> None:
    """Reads the sensors where law or agent need it, and replaces the state by the reading for the law.

    `begins`: whether episodes begin, whose history `begin` has filled; `last`: whether the step of the agent ends.
    """
    if not begins:
        remember(block, n, settings)
    if begins or last or settings.with_reference:
        read_sensors(block, n, settings)
    if settings.law_reads:
        for j in range(n):
            store(block, AT.true_theta + j, LANES, load(block, AT.theta + j, LANES, 4))
            store(block, AT.theta + j, LANES, load(block, AT.read_theta + j, LANES, 4))


@inlined
def restore_state(block: np.ndarray, n: int, settings: StepSettings) -> None:
    """Restores the state after a call of the law."""
    if settings.law_reads:
        for j in range(n):
            store(block, AT.theta + j, LANES, load(block, AT.true_theta + j, LANES, 4))


@inlined
def reading(block: np.ndarray, j: int) -> tuple[float, float, float]:
    """The last reading of theta (rad), theta_dot (rad/s) and x_dot (m/s)."""
    return block[AT.read_theta + j], block[AT.read_theta_dot + j], block[AT.read_x_dot + j]
