"""Sine and cosine that the compiler can evaluate for several environments at once, and what follows from them.

The library's sin and cos are calls, and a loop that calls cannot be vectorised: with them the batch takes three times
as long. These are straight-line arithmetic, the same for one environment and for a batch, bit for bit.

The multiplications and additions of the polynomials are fused by name. A compiler that may fuse as it likes ("fast
math") decides differently in different loops, and the batch would differ from the single environment; one that may not
fuse at all runs at five sixths of the speed. `python -m benchmarks.tricks` measures both.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from capsule_gym.compilation import compile_cached, inlined


@intrinsic
def _llvm_fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """LLVM's fused multiply-add, of doubles."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@njit(forceinline=True)
def fma(a: float, b: float, c: float) -> float:
    """a b + c, rounded once; from Python it runs compiled, too."""
    return _llvm_fma(a, b, c)


# 2 pi to twice the precision of a double.
TURN = 2.0 * math.pi
TURN_REST = 2.4492935982947064e-16
TURNS_PER_RADIAN = 1.0 / TURN
# Added and taken away again it rounds to a whole number, half to even, for anything below 2^51.
ROUNDING = 1.5 * 2.0**52

# Polynomials in z = y^2 that interpolate (sin(y) / y - 1) / z and (cos(y) - 1 + z / 2) / z^2 at the Chebyshev nodes of
# [0, (1.0001 pi / 2)^2]; `tests/capsule_gym/test_trigonometry.py` derives them.
S_0, S_1, S_2, S_3 = -0.16666666666666666, 0.008333333333333316, -0.00019841269841254955, 2.755731921915843e-06
S_4, S_5, S_6, S_7 = -2.5052107616384595e-08, 1.6058977272815506e-10, -7.643969031052769e-13, 2.731428986122616e-15
C_0, C_1, C_2, C_3 = 0.041666666666666664, -0.001388888888888888, 2.4801587301579844e-05, -2.7557319221567154e-07
C_4, C_5, C_6, C_7 = 2.0876756602568905e-09, -1.1470712252875163e-11, 4.777877290768691e-14, -1.521855926409455e-16


@inlined
def sincos(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle in rad: within 3.4e-16 of the exact values up to +-pi / 2, within 1.2e-15 beyond.

    The angle is brought to +-pi by whole turns and halved; in sin(2 y) = 2 sin(y) cos(y) and cos(2 y) = 1 - 2 sin(y)^2
    the half turns that this leaves open cancel, so that no quadrant is to be told apart.
    """
    turns = fma(angle, TURNS_PER_RADIAN, ROUNDING) - ROUNDING
    y = fma(-turns, 0.5 * TURN_REST, fma(-turns, 0.5 * TURN, 0.5 * angle))
    z = y * y
    zz = z * z
    # In pairs and not from the inside out: a single environment waits for every operation that waits for another.
    s = fma(fma(fma(S_7, z, S_6), zz, fma(S_5, z, S_4)), zz * zz, fma(fma(S_3, z, S_2), zz, fma(S_1, z, S_0)))
    c = fma(fma(fma(C_7, z, C_6), zz, fma(C_5, z, C_4)), zz * zz, fma(fma(C_3, z, C_2), zz, fma(C_1, z, C_0)))
    twice = y + y
    sine, double = fma(y * z, s, y), fma(twice * z, s, twice)
    cosine = fma(zz, c, fma(-0.5, z, 1.0))
    return double * cosine, fma(-double, sine, 1.0)


def sines_and_cosines(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`sincos` of every angle of a float64 array, in two arrays of its shape: the same bits as one by one."""
    values = np.ascontiguousarray(angles, np.float64)
    sines, cosines = np.empty_like(values), np.empty_like(values)
    _compiled()(values.reshape(-1), sines.reshape(-1), cosines.reshape(-1))
    return sines.reshape(np.shape(angles)), cosines.reshape(np.shape(angles))


def arccos(cosine: float) -> float:
    """The angle in [0, pi] rad of that cosine, within 7e-16 of the exact value.

    Newton's iteration on `sincos`: half the angle has the cosine and the sine below, and what a step misses is a third
    of the cube of what the last one missed.

    Raises:
        ValueError: if the cosine does not lie in [-1, 1].
    """
    if not -1.0 <= cosine <= 1.0:
        raise ValueError(f"cosine must lie in [-1, 1], got {cosine!r}")
    c, s = math.sqrt(0.5 + 0.5 * cosine), math.sqrt(0.5 - 0.5 * cosine)
    half = 0.25 * math.pi
    for _ in range(5):
        sine, cos = sincos(half)
        half += (s * cos - c * sine) / (c * cos + s * sine)
    return 2.0 * half


def _evaluate(angles: np.ndarray, sines: np.ndarray, cosines: np.ndarray) -> None:
    """Writes `sincos` of every angle."""
    for i in range(angles.size):
        sines[i], cosines[i] = sincos(angles[i])


@lru_cache(maxsize=1)
def _compiled() -> Any:
    """The function above, compiled."""
    return compile_cached(_evaluate)
