"""A fused multiply-add from sums and products, for targets without this instruction, such as WebAssembly.

The algorithm is that of Boldo and Melquiond (Emulation of a FMA and correctly rounded sums, 2008): the rounding errors
of a product and two sums are exact, and their sum, rounded to odd, determines the rounding of the last sum.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from capsule_gym.compilation import inlined

# Splits a significand of 53 bits into two halves (Veltkamp).
CUT = 2.0**27 + 1.0
_ONE = np.uint64(1)


@inlined
def _sum(a: float, b: float) -> tuple[float, float]:
    """a + b and its rounding error (Knuth)."""
    rounded = a + b
    other = rounded - a
    return rounded, (a - (rounded - other)) + (b - other)


@inlined
def _product(a: float, b: float) -> tuple[float, float]:
    """a b and its rounding error (Dekker)."""
    rounded = a * b
    a_high, b_high = CUT * a - (CUT * a - a), CUT * b - (CUT * b - b)
    a_low, b_low = a - a_high, b - b_high
    return rounded, a_low * b_low - (((rounded - a_high * b_high) - a_low * b_high) - a_high * b_low)


@inlined
def _odd_sum(a: float, b: float) -> float:
    """a + b, rounded to the neighbour whose last bit is set unless it is exact."""
    rounded, error = _sum(a, b)
    bits = np.float64(rounded).view(np.uint64)
    if error == 0.0 or bits & _ONE != np.uint64(0):
        return rounded
    odd = bits + _ONE if (error > 0.0) == (rounded > 0.0) else bits - _ONE
    return np.uint64(odd).view(np.float64)


@njit
def fused(a: float, b: float, c: float) -> float:
    """a b + c, rounded once.

    The result has the same bits as that of the processor instruction, unless the absolute value of a number exceeds
    2^995, or those of both a b and c are below 2^-900 and not 0. Episodes do not contain such numbers.
    """
    if a == 0.0 or b == 0.0 or c == 0.0 or not np.isfinite(a * b + c):
        return a * b + c
    product, product_error = _product(a, b)
    low, low_error = _sum(c, product_error)
    high, high_error = _sum(product, low)
    return high + _odd_sum(low_error, high_error)
