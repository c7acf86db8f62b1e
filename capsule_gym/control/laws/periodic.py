"""Periodic motions as `Controller`: an open loop, a PD law, and an oscillator.

`python -m baselines.tuning NAME` has found their parameters.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capsule_gym.control.controller import LAW_DT, Controller, CoreLaw, constant_sizes
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
    rows = max(2, round(series[0] / LAW_DT))
    rate = 2.0 * math.pi / (rows * LAW_DT)
    value = np.full(rows, series[1])
    derivative = np.zeros(rows)
    cosines, sines = np.reshape(series[2:], (2, -1)).tolist()
    for n, (cosine, sine) in enumerate(zip(cosines, sines, strict=True), 1):
        s, c = sincos(2.0 * math.pi * n / rows * np.arange(rows))
        value += cosine * c + sine * s
        derivative += n * rate * (sine * c - cosine * s)
    return value, derivative


def tracking(name: str, columns: Mapping[int, Any], rows: int) -> Controller:
    """State feedback about a periodic trajectory.

    Args:
        name: name of the controller.
        columns: a number or an array for a column; the others are 0.
        rows: rows of the reference table.
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
    torque = np.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT)
    return tracking(name, {FEEDFORWARD: torque}, len(torque))


def open_loop_real() -> Controller:
    """The open loop whose torque was tuned under disturbances."""
    return open_loop(name="open-loop-real")


def pd(parameters: Sequence[float] | None = None) -> Controller:
    """Proportional-derivative control of the angle along a Fourier series with four harmonics.

    Args:
        parameters: period (s), mean, cosines and sines of theta_d (rad), K_theta (N m/rad) and
            K_theta_dot (N m s/rad); None for the tuned ones.
    """
    given = known_parameters("pd") if parameters is None else parameters
    *series, K_theta, K_theta_dot = given
    theta_d, theta_d_dot = fourier(series)
    columns = {
        THETA_D: theta_d,
        THETA_D_DOT: theta_d_dot,
        K_THETA: K_theta,
        K_THETA_DOT: K_theta_dot,
    }
    return tracking("pd", columns, len(theta_d))


def oscillator(parameters: Sequence[float] | None = None) -> Controller:
    """A Hopf oscillator that the state entrains.

    The torque is a polynomial of the oscillator's state, plus that of a spring and a damper.

    Args:
        parameters: the constants of the law `oscillator` of the core, in order, without `dt`; None
            for the tuned ones.
    """
    values = iter(known_parameters("oscillator") if parameters is None else parameters)
    constants: dict[str, Any] = {"dt": LAW_DT}
    for name, size in constant_sizes("oscillator").items():
        if name != "dt":
            constants[name] = [next(values) for _ in range(size)]
    law = CoreLaw("oscillator", **constants)
    return Controller("oscillator", law, NO_REFERENCE, memory=(1.0, 0.0))
