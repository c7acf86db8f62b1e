"""The families of gaits: how a handful of parameters, the time and the observation give a torque.

| family | torque, in parts of the torque limit, clipped to [-1, 1] |
|---|---|
| `harmonics` | four harmonics of a period, plus linear feedback of theta, theta_dot and x_dot |
| `bang-bang` | full torque with free switching times, plus the same feedback |
| `phase-space` | a cubic polynomial of the state without any clock, steep where it pays: a switching surface |

All hold feedback, so that a gait can be an attracting cycle and not a course that only its own plant follows.

A gait's torque is the same bits for one gait and for many, on every machine and in a browser: it is a function of
numbers, compiled as the environment's step is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from baselines.gaits import GAIT_DT as GAIT_DT
from baselines.laws.gait import COEFFICIENTS, cubic
from capsule_gym.compilation import compile_cached, inlined
from capsule_gym.elementary import clip, sincos
from capsule_gym.layout import load

# The torque in parts of the limit: of parameters, time in s, and theta, theta_dot and x_dot in SI units.
Torque = Callable[[tuple[float, ...], float, float, float, float], float]

HARMONICS = 4
# Behind period, offset and both series.
GAINS = 2 + 2 * HARMONICS

FEEDBACK = ("theta", "theta_dot", "x_dot")

# Every family's parameters are filled up with zeros to so many; before them stands the family's number.
LONGEST = len(COEFFICIENTS)
WIDTH = 1 + LONGEST


@inlined
def _feedback(gains: tuple[float, ...], theta: float, theta_dot: float, x_dot: float) -> float:
    """Linear feedback of theta, theta_dot and x_dot."""
    return gains[0] * theta + gains[1] * theta_dot + gains[2] * x_dot


@inlined
def _harmonics(p: tuple[float, ...], time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    sine, cosine = sincos(2.0 * math.pi * time / p[0])
    # Horner's scheme: a sum of (cos_k - i sin_k) exp(i k angle), whose real part is the series.
    real, imaginary = 0.0, 0.0
    for k in range(HARMONICS, 0, -1):
        real, imaginary = real + p[1 + k], imaginary - p[1 + HARMONICS + k]
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
    return p[1] + real + _feedback(p[GAINS:], theta, theta_dot, x_dot)


@inlined
def _impulse(pushes: tuple[float, ...], period: float, moment: float) -> float:
    """Integral of a square wave up to a moment, in s; it stands at 1, -1, 1 and -1 for the times given."""
    cycles = np.floor(moment / period)
    left = moment - cycles * period
    total = cycles * (pushes[0] - pushes[1] + pushes[2] - pushes[3])
    for i in range(4):
        spent = min(left, pushes[i])
        total += spent if i % 2 == 0 else -spent
        left -= spent
    return float(total)


@inlined
def _bang_bang(p: tuple[float, ...], time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    pushes = abs(p[0]), abs(p[1]), abs(p[2]), abs(p[3])
    period = pushes[0] + pushes[1] + pushes[2] + pushes[3]
    # The mean over the step, so that the torque depends continuously on the switching times.
    start = time + p[4] * period
    square = (_impulse(pushes, period, start + GAIT_DT) - _impulse(pushes, period, start)) / GAIT_DT
    return square + _feedback(p[5:], theta, theta_dot, x_dot)


@inlined
def _phase_space(p: tuple[float, ...], time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    sign = 1.0 if x_dot > 0.0 else -1.0 if x_dot < 0.0 else 0.0
    torque: float = cubic(p, theta, theta_dot, x_dot, sign)
    return torque


@dataclass(frozen=True)
class Family:
    """A kind of gait.

    Attributes:
        name: as it stands in the data.
        names: of the parameters, in order.
        units: steps of the search, one per parameter, in the parameter's own unit.
        start: where a search from nothing begins.
        spread: standard deviations of the random starts around it.
        torque: the torque before clipping; see `Torque`.
    """

    name: str
    names: tuple[str, ...]
    units: tuple[float, ...]
    start: tuple[float, ...]
    spread: tuple[float, ...]
    torque: Torque


def _families() -> dict[str, Family]:
    series = (*(f"cos_{k}" for k in range(1, HARMONICS + 1)), *(f"sin_{k}" for k in range(1, HARMONICS + 1)))
    gains, gain_units = tuple(f"gain_{name}" for name in FEEDBACK), (1.0, 0.1, 1.0)
    # Positive feedback of theta_dot starts an oscillation by itself.
    excited = tuple(1.0 if name == "phi_010" else 0.0 for name in COEFFICIENTS)
    steps, durations = ("push_1", "pull_1", "push_2", "pull_2"), (0.25, 0.1, 0.1, 0.25)
    families = (
        Family(
            "harmonics",
            ("period", "offset", *series, *gains),
            (0.05, 0.3, *(0.5 for _ in series), *gain_units),
            (0.65, 0.0, *(0.0 for _ in series), 0.0, 0.0, 0.0),
            (0.08, 0.2, *(0.7 for _ in series), 0.5, 0.05, 0.5),
            _harmonics,
        ),
        Family(
            "bang-bang",
            (*steps, "phase", *gains),
            (0.04, 0.04, 0.04, 0.04, 0.1, *gain_units),
            (*durations, 0.0, 0.0, 0.0, 0.0),
            (0.08, 0.08, 0.08, 0.08, 0.3, 0.3, 0.03, 0.3),
            _bang_bang,
        ),
        Family(
            "phase-space",
            COEFFICIENTS,
            tuple(1.0 for _ in COEFFICIENTS),
            excited,
            tuple(0.7 for _ in COEFFICIENTS),
            _phase_space,
        ),
    )
    return {family.name: family for family in families}


FAMILIES = _families()


# A family's number, as compiled code knows it, is its place.
NUMBERS = {name: number for number, name in enumerate(FAMILIES)}


@inlined
def action(gaits: np.ndarray, place: int, time: float, theta: float, theta_dot: float, x_dot: float) -> float:
    """The action of one gait, in [-1, 1].

    Args:
        gaits: what `pack` makes.
        place: where this one begins.
        time: since the start of the episode, s.
        theta: rad.
        theta_dot: rad/s.
        x_dot: m/s; exactly 0.0 in stick.
    """
    family, p = gaits[place], load(gaits, place + 1, 1, LONGEST)
    if family == 0.0:
        torque = _harmonics(p, time, theta, theta_dot, x_dot)
    elif family == 1.0:
        torque = _bang_bang(p, time, theta, theta_dot, x_dot)
    else:
        torque = _phase_space(p, time, theta, theta_dot, x_dot)
    return clip(torque, 1.0)


def pack(families: Sequence[str], parameters: Sequence[Sequence[float]]) -> np.ndarray:
    """Gaits as compiled code takes them: the family's number, then the parameters.

    Args:
        families: of each gait.
        parameters: of each, as many as its family has.

    Returns:
        Shape (gaits, `WIDTH`), float64.
    """
    packed = np.zeros((len(families), WIDTH))
    for row, name, own in zip(packed, families, parameters, strict=True):
        row[0], row[1 : 1 + len(own)] = NUMBERS[name], own
    return packed


def actions(gaits: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    """The actions of many gaits.

    Args:
        gaits: what `pack` makes.
        time: since the start of the episode, s.
        observations: one per gait, float32; theta, theta_dot and x_dot come first.

    Returns:
        Shape (gaits, 1), float32, in [-1, 1].
    """
    out = np.empty((len(gaits), 1), np.float32)
    _compiled()(gaits.reshape(-1), time, observations[:, :3].astype(np.float64), out)
    return out


def _act(gaits: np.ndarray, time: float, states: np.ndarray, out: np.ndarray) -> None:
    """Writes `action` of every gait; its state is theta, theta_dot and x_dot."""
    for n in range(out.shape[0]):
        out[n, 0] = action(gaits, n * WIDTH, time, states[n, 0], states[n, 1], states[n, 2])


@lru_cache(maxsize=1)
def _compiled() -> Any:
    """The function above, compiled."""
    return compile_cached(_act)
