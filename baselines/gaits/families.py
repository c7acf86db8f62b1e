"""The families of gaits: how parameters, the time and the observation give a torque.

| family | torque over the torque limit, clipped to [-1, 1] | parameters |
|---|---|---|
| `harmonics` | Fourier series with four harmonics, plus feedback | period, offset, 4 cosines, 4 sines, gains |
| `bang-bang` | full torque with free switching times, plus feedback | 4 durations, phase, gains |
| `phase-space` | cubic polynomial of the state | `COEFFICIENTS` |

The feedback is linear in theta, theta_dot and x_dot, with three gains. It makes a gait an attracting limit cycle.

Arithmetic is elementwise, in one order, so that a gait gives the same bits alone and with others, on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from baselines.gaits import GAIT_DT as GAIT_DT
from baselines.laws.gait import COEFFICIENTS
from capsule_gym.elementary import sincos

HARMONICS = 4
# Index of the gains behind period, offset and both series.
GAINS = 2 + 2 * HARMONICS
# Encoded gaits have a common width: the family's number, then its parameters, padded with zeros.
MAX_PARAMETERS = len(COEFFICIENTS)
WIDTH = 1 + MAX_PARAMETERS

# Scales in rad, rad/s and m/s that make the polynomial's coefficients comparable.
STATE_SCALE = (1.0, 5.0, 0.3)


def _feedback(gains: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Linear feedback of theta, theta_dot and x_dot."""
    return gains[0] * state[0] + gains[1] * state[1] + gains[2] * state[2]


def harmonics(p: np.ndarray, time: float, state: np.ndarray) -> np.ndarray:
    """The torque of a Fourier series with feedback, divided by its limit, before clipping."""
    sine, cosine = sincos(2.0 * math.pi * time / p[0])
    # Horner's scheme: a sum of (cos_k - i sin_k) exp(i k angle), whose real part is the series.
    real, imaginary = np.zeros_like(sine), np.zeros_like(sine)
    for k in range(HARMONICS, 0, -1):
        real, imaginary = real + p[1 + k], imaginary - p[1 + HARMONICS + k]
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
    return p[1] + real + _feedback(p[GAINS:], state)


def _square_integral(durations: np.ndarray, period: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Integral up to a time, s, of a square wave that is 1, -1, 1 and -1 for the given durations."""
    cycles = np.floor(time / period)
    remaining = time - cycles * period
    total = cycles * (durations[0] - durations[1] + durations[2] - durations[3])
    for i in range(4):
        elapsed = np.minimum(remaining, durations[i])
        total = total + elapsed if i % 2 == 0 else total - elapsed
        remaining = remaining - elapsed
    return total


def bang_bang(p: np.ndarray, time: float, state: np.ndarray) -> np.ndarray:
    """Full torque with free switching times, plus feedback."""
    durations = abs(p[:4])
    period = durations[0] + durations[1] + durations[2] + durations[3]
    # The mean over the step, so that the torque depends continuously on the switching times.
    start = time + p[4] * period
    before, after = (_square_integral(durations, period, moment) for moment in (start, start + GAIT_DT))
    return (after - before) / GAIT_DT + _feedback(p[5:], state)


def phase_space(p: np.ndarray, time: float, state: np.ndarray) -> np.ndarray:
    """The cubic polynomial of the state, plus a step in the direction of slip; it does not depend on the time."""
    a, b, c = state / np.array(STATE_SCALE)[:, None]
    aa, bb, cc = a * a, b * b, c * c
    p000, p001, p002, p003, p010, p011, p012, p020, p021, p030 = p[:10]
    p100, p101, p102, p110, p111, p120, p200, p201, p210, p300, step = p[10:]
    torque = step * np.sign(c) + p000 + p001 * c + p002 * cc + p003 * (cc * c)
    torque = torque + p010 * b + p011 * b * c + p012 * b * cc + p020 * bb + p021 * bb * c + p030 * (bb * b)
    torque = torque + p100 * a + p101 * a * c + p102 * a * cc + p110 * a * b + p111 * a * b * c + p120 * a * bb
    return torque + p200 * aa + p201 * aa * c + p210 * aa * b + p300 * (aa * a)


class Family(NamedTuple):
    """A kind of gait.

    Attributes:
        torque: its torque divided by the limit, shape (n,), from parameters (parameters, n), the time in s, and theta,
            theta_dot and x_dot, shape (3, n).
        parameters: number of parameters.
    """

    torque: Callable[[np.ndarray, float, np.ndarray], np.ndarray]
    parameters: int


FAMILIES = {
    "harmonics": Family(harmonics, GAINS + 3),
    "bang-bang": Family(bang_bang, 8),
    "phase-space": Family(phase_space, len(COEFFICIENTS)),
}


def encode(family: str, parameters: np.ndarray) -> np.ndarray:
    """Encodes gaits of one family: the family's number, then the parameters; shape (n, `WIDTH`)."""
    encoded = np.zeros((len(parameters), WIDTH))
    encoded[:, 0], encoded[:, 1 : 1 + parameters.shape[1]] = tuple(FAMILIES).index(family), parameters
    return encoded


def actions(gaits: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    """The actions of gaits from `encode` after a time in s, shape (gaits, 1), float32, in [-1, 1].

    `observations` has one row per gait, float32, which begins with theta, theta_dot and x_dot.
    """
    out = np.empty((len(gaits), 1), np.float32)
    states = observations[:, :3].T.astype(np.float64)
    for number, family in enumerate(FAMILIES.values()):
        rows = np.flatnonzero(gaits[:, 0] == number)
        if rows.size:
            parameters = gaits[rows, 1 : 1 + family.parameters].T
            out[rows, 0] = np.clip(family.torque(parameters, time, states[:, rows]), -1.0, 1.0)
    return out
