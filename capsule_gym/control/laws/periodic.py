"""Periodic motions as `Controller`: an open loop, a PD law, and an oscillator.

`python -m baselines.tuning NAME` has found their parameters.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capsule_gym.control.controller import LAW_DT, Controller, CoreLaw
from capsule_gym.control.laws.gains import NO_REFERENCE, known_parameters
from capsule_gym.core import _core
from capsule_gym.core.elementary import sincos
from capsule_gym.tasks.task import TORQUE_LIMIT

# The columns of the law `tracking` of the core.
THETA_D, THETA_D_DOT, FEEDFORWARD, K_THETA, K_THETA_DOT = range(_core.LAWS["tracking"][2])


def fourier(series: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """One period of a Fourier series and of its derivative, sampled every `LAW_DT`.

    Args:
        series: the period in s, which is rounded to a multiple of `LAW_DT`, the mean, the cosines
            and the sines.
    """
    mean, coefficients = series[1], np.reshape(series[2:], (2, -1))
    rows = max(2, round(series[0] / LAW_DT))
    rate = 2.0 * math.pi / (rows * LAW_DT)
    value, derivative = np.full(rows, mean), np.zeros(rows)
    for n, (cosine, sine) in enumerate(coefficients.T.tolist(), 1):
        s, c = sincos(2.0 * math.pi * n / rows * np.arange(rows))
        value += cosine * c + sine * s
        derivative += n * rate * (sine * c - cosine * s)
    return value, derivative


def tracking(name: str, columns: Mapping[int, Any], rows: int) -> Controller:
    """State feedback about a periodic trajectory; a column is a number or an array, and 0 if it is
    not given.
    """
    table = np.zeros((rows, _core.LAWS["tracking"][2]))
    for column, values in columns.items():
        table[:, column] = values
    return Controller(name, CoreLaw("tracking"), table)


def open_loop(parameters: Sequence[float] | None = None, name: str = "open-loop") -> Controller:
    """Torque as a function of time alone: a Fourier series with four harmonics.

    Args:
        parameters: period (s), mean, cosines and sines of the torque (N m); None for the tuned
            ones.
        name: name of the controller; without parameters, also the entry of the file.
    """
    torque, _ = fourier(known_parameters(name) if parameters is None else parameters)
    return tracking(name, {FEEDFORWARD: np.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT)}, len(torque))


def open_loop_real() -> Controller:
    """The open loop whose torque was tuned under disturbances."""
    return open_loop(name="open-loop-real")


def pd(parameters: Sequence[float] | None = None) -> Controller:
    """Proportional-derivative control of the pendulum's angle along a Fourier series with four
    harmonics.

    Args:
        parameters: period (s), mean, cosines and sines of theta_d (rad), K_theta (N m/rad) and
            K_theta_dot (N m s/rad); None for the tuned ones.
    """
    *series, K_theta, K_theta_dot = known_parameters("pd") if parameters is None else parameters
    theta_d, theta_d_dot = fourier(series)
    columns = {
        THETA_D: theta_d,
        THETA_D_DOT: theta_d_dot,
        K_THETA: K_theta,
        K_THETA_DOT: K_theta_dot,
    }
    return tracking("pd", columns, len(theta_d))


def oscillator(parameters: Sequence[float] | None = None) -> Controller:
    """A Hopf oscillator that the state entrains; a polynomial of its state, a spring and a damper
    give the torque.

    Args:
        parameters: the constants of the law `oscillator` of the core, in order, without `dt`; None
            for the tuned ones.
    """
    values = iter(known_parameters("oscillator") if parameters is None else parameters)
    items = [item.partition(":") for item in _core.LAWS["oscillator"][0].split() if item != "dt"]
    constants = {key: [next(values) for _ in range(int(count or 1))] for key, _, count in items}
    return Controller(
        "oscillator", CoreLaw("oscillator", **constants, dt=LAW_DT), NO_REFERENCE, memory=(1.0, 0.0)
    )
