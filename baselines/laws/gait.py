"""A gait without a clock as a `Controller`: the torque is a polynomial of the state, and a guard keeps the contact.

The law does not observe the plant and follows no reference. `python -m baselines.gaits --law` has found the
numbers in `gait.json`. The guard of `gait_identifying` identifies a platform that is lighter than those of the search
by the momentum that the pendulum gives it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, written
from capsule_gym.compilation import inlined
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller, Law
from capsule_gym.elementary import clip, sincos
from capsule_gym.observation import CELLS, estimates, identify
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.task import TORQUE_LIMIT

FILE = Path(__file__).with_name("gait.json")
# Scales in rad, rad/s and m/s that make the polynomial's coefficients comparable.
STATE_SCALE = (1.0, 5.0, 0.3)
# phi_ijk is the coefficient of theta^i theta_dot^j x_dot^k, each divided by its scale.
COEFFICIENTS = (
    *(f"phi_{i}{j}{k}" for i in range(4) for j in range(4) for k in range(4) if i + j + k <= 3),
    "sign_x_dot",
)
# The guard's gain in N m s^2, and the theta_dot^2 cos(theta), 1/s^2, from which it acts.
PARAMETERS = (*COEFFICIENTS, "guard_gain", "guard_from")
# The guard is designed for this mass of the platform and all larger ones, kg.
_WIDE = RANDOMIZATIONS["wide"].M
assert _WIDE is not None
LIGHTEST = _WIDE[0]
# Factor by which the guard's threshold falls faster than the weight of a lighter platform: of 1.0, 1.2, 1.3 and 1.5
# the first without a failure in 1000 episodes from the distribution of `extrapolation`.
CAUTION = 1.3
# The two observed entries of the reference and its phase stay 0.
NO_REFERENCE = np.zeros((1, 2))


@inlined
def cubic(coefficients: tuple[Any, ...], theta: Any, theta_dot: Any, x_dot: Any, sign: Any) -> Any:
    """The cubic polynomial of the state plus a step in the direction of slip; coefficients as in `COEFFICIENTS`.

    The state (rad, rad/s, m/s) and the sign of x_dot are numbers or arrays of one shape, the coefficients numbers or
    arrays.
    """
    a, b, c = theta / STATE_SCALE[0], theta_dot / STATE_SCALE[1], x_dot / STATE_SCALE[2]
    aa, bb, cc = a * a, b * b, c * c
    p000, p001, p002, p003, p010, p011, p012, p020, p021, p030 = coefficients[:10]
    p100, p101, p102, p110, p111, p120, p200, p201, p210, p300, step = coefficients[10:]
    torque = step * sign + p000 + p001 * c + p002 * cc + p003 * (cc * c)
    torque = torque + p010 * b + p011 * b * c + p012 * b * cc + p020 * bb + p021 * bb * c + p030 * (bb * b)
    torque = torque + p100 * a + p101 * a * c + p102 * a * cc + p110 * a * b + p111 * a * b * c + p120 * a * bb
    return torque + p200 * aa + p201 * aa * c + p210 * aa * b + p300 * (aa * a)


@inlined
def guarded_torque(theta: float, theta_dot: float, x_dot: float, parameters: tuple[float, ...]) -> float:
    """The gait's torque within the limit, less the guard's, in N m; the state in rad, rad/s and m/s, 0.0 in stick.

    The normal force is N = (M + m) g - m l (theta_dot^2 cos(theta) + theta_dot_dot sin(theta)): a pendulum that is fast
    while it is upright lifts the platform, in either direction. The guard brakes it before it is too fast.
    """
    sign = 1.0 if x_dot > 0.0 else -1.0 if x_dot < 0.0 else 0.0
    torque = clip(TORQUE_LIMIT * cubic(parameters[:-2], theta, theta_dot, x_dot, sign), TORQUE_LIMIT)
    cos = sincos(theta)[1]
    excess = max(0.0, theta_dot * theta_dot * cos - parameters[-1])
    brake = parameters[-2] * excess
    return torque - (brake if theta_dot > 0.0 else -brake)


def gait_law(parameters: tuple[float, ...]) -> Law:
    """The law with its parameters in its closure, where the compiler sees them; in the order of `PARAMETERS`."""

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        return guarded_torque(theta, theta_dot, x_dot, parameters), memory

    return law


def identifying_law(parameters: tuple[float, ...]) -> Law:
    """The law with its parameters in its closure, and the filter of `capsule_gym.observation` in its memory."""
    *others, guard_from = parameters
    rest = tuple(others)
    m, l, g = NOMINAL.m, NOMINAL.l, NOMINAL.g

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: Any, reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        memory = identify(memory, theta, theta_dot, x_dot, m, l, g, LAW_DT)
        M = min(LIGHTEST, estimates(memory)[0])
        share = 1.0 - CAUTION * (LIGHTEST - M) / (LIGHTEST + m)
        return guarded_torque(theta, theta_dot, x_dot, (*rest, share * guard_from)), memory

    return law


@lru_cache(maxsize=1)
def known_parameters() -> tuple[float, ...]:
    """The parameters of `gait.json`, in the order of `PARAMETERS`, read once."""
    content = json.loads(FILE.read_text(encoding="utf-8"))["parameters"]
    return tuple(float(content[name]) for name in PARAMETERS)


def gait(parameters: Sequence[float] | None = None) -> Controller:
    """The gait: its torque is a function of theta, theta_dot and x_dot. It does not observe M and mu.

    Args:
        parameters: numbers in the order of `PARAMETERS`; None for those of `gait.json`.

    Raises:
        TypeError: if a parameter is not a number.
        ValueError: if a parameter is not finite, or their number is wrong.
    """
    return Controller("gait", gait_law(_checked(parameters)), NO_REFERENCE)


def gait_identifying(parameters: Sequence[float] | None = None) -> Controller:
    """The gait with a guard that estimates M while the platform slips and acts earlier on light platforms.

    On platforms within the range of `wide`, once M is estimated, the torque is that of `gait`.

    Args:
        parameters: see `gait`.

    Raises:
        TypeError: if a parameter is not a number.
        ValueError: if a parameter is not finite, or their number is wrong.
    """
    return Controller("gait_identifying", identifying_law(_checked(parameters)), NO_REFERENCE, memory=(0.0,) * CELLS)


def _checked(parameters: Sequence[float] | None) -> tuple[float, ...]:
    """The parameters as floats; None gives those of `gait.json`."""
    if parameters is None:
        return known_parameters()
    if len(parameters) != len(PARAMETERS):
        raise ValueError(
            f"parameters must be {len(PARAMETERS)} numbers, {', '.join(PARAMETERS)}, got {written(parameters)}"
        )
    return tuple(
        check_number(f"parameters, {name},", value, "a finite number")
        for name, value in zip(PARAMETERS, parameters, strict=True)
    )
