"""Sine, cosine, logarithm and inverse cosine with the same bits on every machine.

They are the functions of the core (`capsule_gym/core/numbers/elementary.hpp`), over arrays. Those
of the standard libraries differ in the last digit between versions and instruction sets.
"""

import math

import numpy as np

from capsule_gym.core.native import evaluate


def sincos(angle: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of angles in rad.

    They are within 3.4e-16 of the exact values up to +-pi / 2, within 1.2e-15 beyond.
    """
    sine, cosine = evaluate("sincos", angle)
    return sine, cosine


def log(x: np.ndarray | float) -> np.ndarray:
    """The natural logarithm of positive, normal numbers.

    It is within 2.2e-16 of the exact value, beyond +-1 relative to it.
    """
    return evaluate("log", x)[0]


def arccos(cosine: float) -> float:
    """The angle in [0, pi] rad of that cosine, within 7e-16 of the exact value.

    Newton's iteration on `sincos`: half the angle has the cosine and the sine below, and the error
    of a step is a third of the cube of the previous error.
    """
    c = math.sqrt(0.5 + 0.5 * cosine)
    s = math.sqrt(0.5 - 0.5 * cosine)
    half = 0.25 * math.pi
    for _ in range(5):
        sin, cos = map(float, sincos(half))
        half += (s * cos - c * sin) / (c * cos + s * sin)
    return 2.0 * half
