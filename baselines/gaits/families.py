"""The families of gaits: how parameters, the time and the observation give a torque.

| family | torque over the torque limit, clipped to [-1, 1] | parameters |
|---|---|---|
| `harmonics` | Fourier series with four harmonics, plus feedback | period, offset, 4 cosines, 4 sines, gains |
| `bang-bang` | full torque with free switching times, plus feedback | 4 durations, phase, gains |
| `phase-space` | cubic polynomial of the state | `COEFFICIENTS` |

The feedback is linear in theta, theta_dot and x_dot, with three gains. It makes a gait an attracting limit cycle.

The torque is a scalar function, compiled like the environment's step. It gives the same bits for one gait and for many,
on every machine and in a browser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.gaits import GAIT_DT as GAIT_DT
from baselines.laws.gait import COEFFICIENTS
from capsule_gym.compilation import cached_entry, inlined
from capsule_gym.elementary import clip, sincos
from capsule_gym.layout import load

HARMONICS = 4
# Index of the gains behind period, offset and both series.
GAINS = 2 + 2 * HARMONICS
# Encoded gaits have a common width: the family's number, then its parameters, padded with zeros.
MAX_PARAMETERS = len(COEFFICIENTS)
WIDTH = 1 + MAX_PARAMETERS

# Scales in rad, rad/s and m/s that make the polynomial's coefficients comparable.
STATE_SCALE = (1.0, 5.0, 0.3)


@inlined
def _feedback(gains: tuple[float, ...], theta: float, theta_dot: float, x_dot: float) -> float:
    """Linear feedback of theta, theta_dot and x_dot."""
    return gains[0] * theta + gains[1] * theta_dot + gains[2] * x_dot


@inlined
def harmonics(p: tuple[float, ...], time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    """The torque of a Fourier series with feedback, divided by its limit, before clipping."""
    sine, cosine = sincos(2.0 * math.pi * time / p[0])
    # Horner's scheme: a sum of (cos_k - i sin_k) exp(i k angle), whose real part is the series.
    real, imaginary = 0.0, 0.0
    for k in range(HARMONICS, 0, -1):
        real, imaginary = real + p[1 + k], imaginary - p[1 + HARMONICS + k]
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
    return p[1] + real + _feedback(p[GAINS:], theta, theta_dot, x_dot)


@inlined
def _square_integral(durations: tuple[float, ...], period: float, time: float) -> float:
    """Integral up to a time, s, of a square wave that is 1, -1, 1 and -1 for the given durations."""
    cycles = np.floor(time / period)
    remaining = time - cycles * period
    total = cycles * (durations[0] - durations[1] + durations[2] - durations[3])
    for i in range(4):
        elapsed = min(remaining, durations[i])
        total += elapsed if i % 2 == 0 else -elapsed
        remaining -= elapsed
    return float(total)


@inlined
def bang_bang(p: tuple[float, ...], time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    """Full torque with free switching times, plus feedback."""
    durations = abs(p[0]), abs(p[1]), abs(p[2]), abs(p[3])
    period = durations[0] + durations[1] + durations[2] + durations[3]
    # The mean over the step, so that the torque depends continuously on the switching times.
    start = time + p[4] * period
    square = (
        _square_integral(durations, period, start + GAIT_DT) - _square_integral(durations, period, start)
    ) / GAIT_DT
    return square + _feedback(p[5:], theta, theta_dot, x_dot)


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
def phase_space(p: tuple[float, ...], time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    """The cubic polynomial of the state; it does not depend on the time."""
    sign = 1.0 if x_dot > 0.0 else -1.0 if x_dot < 0.0 else 0.0
    torque: float = cubic(p, theta, theta_dot, x_dot, sign)
    return torque


@dataclass(frozen=True)
class Family:
    """A kind of gait.

    Attributes:
        units: scale of each parameter in the search, in the parameter's own unit.
        start: parameters around which a search without known gaits starts.
        spread: standard deviations of these starts.
    """

    units: tuple[float, ...]
    start: tuple[float, ...]
    spread: tuple[float, ...]


_SERIES = 2 * HARMONICS
FAMILIES = {
    "harmonics": Family(
        units=(0.05, 0.3, *(0.5,) * _SERIES, 1.0, 0.1, 1.0),
        start=(0.65, 0.0, *(0.0,) * _SERIES, 0.0, 0.0, 0.0),
        spread=(0.08, 0.2, *(0.7,) * _SERIES, 0.5, 0.05, 0.5),
    ),
    "bang-bang": Family(
        units=(0.04, 0.04, 0.04, 0.04, 0.1, 1.0, 0.1, 1.0),
        start=(0.25, 0.1, 0.1, 0.25, 0.0, 0.0, 0.0, 0.0),
        spread=(0.08, 0.08, 0.08, 0.08, 0.3, 0.3, 0.03, 0.3),
    ),
    "phase-space": Family(
        units=(1.0,) * len(COEFFICIENTS),
        # Positive feedback of theta_dot starts an oscillation.
        start=tuple(1.0 if name == "phi_010" else 0.0 for name in COEFFICIENTS),
        spread=(0.7,) * len(COEFFICIENTS),
    ),
}


@inlined
def action(gaits: np.ndarray, offset: int, time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    """The action, in [-1, 1], of the gait that begins at `offset` of the flat array from `encode`; the time is in s."""
    # The families' numbers are their places in `FAMILIES`.
    family, p = gaits[offset], load(gaits, offset + 1, 1, MAX_PARAMETERS)
    if family == 0.0:
        torque = harmonics(p, time, theta, theta_dot, x_dot)
    elif family == 1.0:
        torque = bang_bang(p, time, theta, theta_dot, x_dot)
    else:
        torque = phase_space(p, time, theta, theta_dot, x_dot)
    return clip(torque, 1.0)


def encode(family: str, parameters: np.ndarray) -> np.ndarray:
    """Encodes gaits of one family for compiled code: the family's number, then the parameters; shape (n, `WIDTH`)."""
    encoded = np.zeros((len(parameters), WIDTH))
    encoded[:, 0], encoded[:, 1 : 1 + parameters.shape[1]] = tuple(FAMILIES).index(family), parameters
    return encoded


def actions(gaits: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    """The actions of gaits from `encode` after a time in s, shape (gaits, 1), float32, in [-1, 1].

    `observations` has one row per gait, float32, which begins with theta, theta_dot and x_dot.
    """
    out = np.empty((len(gaits), 1), np.float32)
    entry = cached_entry(_act, "void(float64[::1], float64, float64[:, ::1], float32[:, ::1])")
    entry.call(gaits.reshape(-1), time, observations[:, :3].astype(np.float64), out)
    return out


def _act(gaits: np.ndarray, time: float, states: np.ndarray, out: np.ndarray) -> None:
    """Writes the `action` of every gait; its state is theta, theta_dot and x_dot."""
    for n in range(out.shape[0]):
        out[n, 0] = action(gaits, n * WIDTH, time, states[n, 0], states[n, 1], states[n, 2])
