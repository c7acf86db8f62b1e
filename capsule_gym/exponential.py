"""Exponential function, logarithm and hyperbolic tangent that give the same bits on every machine.

The libraries' differ in the last digit from one version and one instruction set to the next. These are straight-line
arithmetic with fused multiply-adds by name, like `capsule_gym.trigonometry.sincos`: the compiler can evaluate them for
several environments at once, and one environment gives the bits of a batch.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit, types
from numba.extending import intrinsic

from capsule_gym.compilation import inlined
from capsule_gym.trigonometry import ROUNDING, fma

# The logarithm of 2 to twice the precision of a double.
LN_2 = 0.6931471805599453
LN_2_REST = 2.3190468138462996e-17
LOG2_E = 1.0 / LN_2

# Interpolates (exp(r) - 1 - r) / r^2 at the Chebyshev nodes of +-1.0001 ln(2) / 2, which leaves 4.1e-17 of exp(r) - 1;
# `tests/capsule_gym/test_exponential.py` derives it.
E_0, E_1, E_2, E_3 = 0.5000000000000001, 0.16666666666666669, 0.04166666666662413, 0.008333333333330062
E_4, E_5, E_6, E_7 = 0.0013888888917213717, 0.00019841269863053618, 2.4801521295954376e-05, 2.7557268459997064e-06
E_8, E_9 = 2.7620088445409746e-07, 2.510038549551032e-08

# From here on the tangent is 1 to the last digit.
FLAT = 20.0


@intrinsic
def _llvm_power_of_two(typing_context: Any, shifted: Any) -> Any:
    """2^n from n + ROUNDING: the lowest digits of that sum become the exponent."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        integer = context.get_value_type(types.int64)
        exponent = builder.shl(builder.bitcast(arguments[0], integer), integer(52))
        one = integer(1023 << 52)
        return builder.bitcast(builder.add(exponent, one), context.get_value_type(types.float64))

    return types.float64(types.float64), generate


@njit(forceinline=True)
def power_of_two(shifted: float) -> float:
    """2^n from n + ROUNDING, for whole n in +-1022; from Python it runs compiled, too."""
    return _llvm_power_of_two(shifted)


@inlined
def _exponential(x: float) -> tuple[float, float]:
    """2^n and exp(r) - 1 with x = n ln(2) + r and |r| <= ln(2) / 2; |n| must not exceed 1022."""
    shifted = fma(x, LOG2_E, ROUNDING)
    n = shifted - ROUNDING
    r = fma(-n, LN_2_REST, fma(-n, LN_2, x))
    z = r * r
    zz = z * z
    low, middle = fma(fma(E_3, r, E_2), z, fma(E_1, r, E_0)), fma(fma(E_7, r, E_6), z, fma(E_5, r, E_4))
    p = fma(fma(fma(E_9, r, E_8), zz, middle), zz, low)
    return power_of_two(shifted), fma(z, p, r)


@inlined
def exp(x: float) -> float:
    """e^x, within 1.7e-16 of the exact value relative to it; |x| must not exceed 708."""
    scale, rest = _exponential(x)
    return fma(scale, rest, scale)


@inlined
def tanh(x: float) -> float:
    """The hyperbolic tangent, within 4.3e-16 of the exact value relative to it."""
    size = abs(x)
    # What is no number stays none.
    size = FLAT if size > FLAT else size
    scale, rest = _exponential(-2.0 * size)
    # exp(-2 |x|) - 1
    e = fma(scale, rest, scale - 1.0)
    return math.copysign(e / (e + 2.0), x)


@inlined
def logarithm(x: float) -> float:
    """`log` for compiled code: of what is no positive, normal number it is nothing that means anything."""
    mantissa, exponent = math.frexp(x)
    y = fma(float(exponent), LN_2, mantissa - 1.0)
    for _ in range(4):
        power = exp(y)
        y += 2.0 * (x - power) / (x + power)
    return y


def log(x: float) -> float:
    """The natural logarithm of a positive, normal number, within 2.2e-16 of the exact value, beyond +-1 relative to it.

    Halley's iteration on `exp`, each step of which triples the digits.

    Raises:
        ValueError: if x is not positive and finite.
    """
    if not 0.0 < x < math.inf:
        raise ValueError(f"x must be a finite number > 0, got {x!r}")
    return logarithm(x)
