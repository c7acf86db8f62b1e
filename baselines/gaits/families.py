"""The families of gaits: how a handful of parameters, the time and the observation give a torque.

| family | torque, in parts of the torque limit, clipped to [-1, 1] |
|---|---|
| `harmonics` | four harmonics of a period, plus linear feedback of theta, theta_dot and x_dot |
| `bang-bang` | full torque with free switching times, plus the same feedback |
| `phase-space` | a cubic polynomial of the state without any clock, steep where it pays: a switching surface |

All hold feedback, so that a gait can be an attracting cycle and not a course that only its own plant follows.

A gait's torque is the same bits on every machine: real arithmetic entry by entry, where numpy's products of complex
numbers and its sums of products are fused on some processors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from baselines.gaits import GAIT_DT as GAIT_DT
from baselines.laws.gait import COEFFICIENTS, cubic
from capsule_gym.trigonometry import sines_and_cosines

# The torque of many candidates at once: parameters of shape (size, n), time in s, observations of shape (n, entries).
Torque = Callable[[np.ndarray, float, np.ndarray], np.ndarray]

HARMONICS = 4

FEEDBACK = ("theta", "theta_dot", "x_dot")


def _feedback(gains: np.ndarray, observations: np.ndarray) -> np.ndarray:
    """Linear feedback of theta, theta_dot and x_dot: the first three observations."""
    torque: np.ndarray = gains[0] * observations[:, 0] + gains[1] * observations[:, 1] + gains[2] * observations[:, 2]
    return torque


def _harmonics(parameters: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    sine, cosine = sines_and_cosines(2.0 * math.pi * time / parameters[0])
    # Horner's scheme: a sum of (cos_k - i sin_k) exp(i k angle), whose real part is the series.
    real = imaginary = np.zeros_like(sine)
    for k in range(HARMONICS, 0, -1):
        real, imaginary = real + parameters[1 + k], imaginary - parameters[1 + HARMONICS + k]
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
    return parameters[1] + real + _feedback(parameters[2 + 2 * HARMONICS :], observations)


def _bang_bang(parameters: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    durations = np.abs(parameters[:4])
    period = durations[0] + durations[1] + durations[2] + durations[3]

    def impulse(moment: np.ndarray) -> np.ndarray:
        """Integral of the square wave up to a moment, in s."""
        cycles = np.floor(moment / period)
        left = moment - cycles * period
        total = cycles * (durations[0] - durations[1] + durations[2] - durations[3])
        for i, duration in enumerate(durations):
            spent = np.minimum(left, duration)
            total += spent if i % 2 == 0 else -spent
            left = left - spent
        return total

    # The mean over the step, so that the torque depends continuously on the switching times.
    start = time + parameters[4] * period
    square = (impulse(start + GAIT_DT) - impulse(start)) / GAIT_DT
    return square + _feedback(parameters[5:], observations)


def _phase_space(parameters: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    theta, theta_dot, x_dot = observations[:, 0], observations[:, 1], observations[:, 2]
    torque: np.ndarray = cubic(tuple(parameters), theta, theta_dot, x_dot, np.sign(x_dot))
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
        torque: the torque in parts of the limit, before clipping; see `Torque`.
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


def actions(family: Family, parameters: np.ndarray, time: float, observations: np.ndarray) -> np.ndarray:
    """The actions of many gaits of one family.

    Args:
        family: of the gaits.
        parameters: shape (size, n), one column per environment.
        time: since the start of the episode, s.
        observations: shape (n, entries), as the direct-torque task gives them.

    Returns:
        Shape (n, 1), float32, in [-1, 1].
    """
    torque = family.torque(parameters, time, observations.astype(np.float64))
    return np.clip(torque, -1.0, 1.0).astype(np.float32)[:, None]
