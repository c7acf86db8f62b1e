"""Sine, cosine, exponential, logarithm and hyperbolic tangent with the same bits on every machine.

The results of the standard libraries differ in the last digit between versions and instruction sets, and a loop that
calls them cannot be vectorised: with the library's sin and cos a batch takes three times as long. The functions here
are straight-line arithmetic that the compiler evaluates for several environments at once; one environment gives the
bits of a batch.

The multiplications and additions of the polynomials are fused explicitly. A compiler that may fuse freely ("fast
math") decides differently in different loops, so a batch would differ from a single environment; one that may not fuse
at all runs at five sixths of the speed.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import struct
import sys
from typing import Any

import numpy as np

from capsule_gym.compilation import cached_entry, inlined, intrinsic

if hasattr(math, "fma"):
    _fma = math.fma
else:
    # For Python before 3.13. The C library's function rounds once as well.
    _fma = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else ctypes.util.find_library("m")).fma
    _fma.restype, _fma.argtypes = ctypes.c_double, [ctypes.c_double] * 3


def _define_fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    from numba import types

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@intrinsic(_define_fma)
def fma(a: float, b: float, c: float) -> float:
    """a b + c, rounded once."""
    value: float = _fma(a, b, c)
    return value


# 2 pi to twice the precision of a double.
TURN = 2.0 * math.pi
TURN_REST = 2.4492935982947064e-16
TURNS_PER_RADIAN = 1.0 / TURN
# Adding and subtracting it rounds a number below 2^51 to a whole number, half to even.
ROUNDING = 1.5 * 2.0**52

# Polynomials in z = y^2 that interpolate (sin(y) / y - 1) / z and (cos(y) - 1 + z / 2) / z^2 at the Chebyshev nodes of
# [0, (1.0001 pi / 2)^2]; `tests/capsule_gym/test_elementary.py` derives them.
S_0, S_1, S_2, S_3 = -0.16666666666666666, 0.008333333333333316, -0.00019841269841254955, 2.755731921915843e-06
S_4, S_5, S_6, S_7 = -2.5052107616384595e-08, 1.6058977272815506e-10, -7.643969031052769e-13, 2.731428986122616e-15
C_0, C_1, C_2, C_3 = 0.041666666666666664, -0.001388888888888888, 2.4801587301579844e-05, -2.7557319221567154e-07
C_4, C_5, C_6, C_7 = 2.0876756602568905e-09, -1.1470712252875163e-11, 4.777877290768691e-14, -1.521855926409455e-16


@inlined
def sincos(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle in rad: within 3.4e-16 of the exact values up to +-pi / 2, within 1.2e-15 beyond.

    The angle is brought to +-pi by whole turns and halved; in sin(2 y) = 2 sin(y) cos(y) and cos(2 y) = 1 - 2 sin(y)^2
    the remaining half turns cancel, so that no quadrant has to be determined.
    """
    turns = fma(angle, TURNS_PER_RADIAN, ROUNDING) - ROUNDING
    y = fma(-turns, 0.5 * TURN_REST, fma(-turns, 0.5 * TURN, 0.5 * angle))
    z = y * y
    zz = z * z
    # In pairs instead of Horner's scheme: a single environment waits for every operation that waits for another.
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
    entry = cached_entry(_evaluate, "void(float64[::1], float64[::1], float64[::1])")
    entry.call(values.reshape(-1), sines.reshape(-1), cosines.reshape(-1))
    return sines.reshape(np.shape(angles)), cosines.reshape(np.shape(angles))


def arccos(cosine: float) -> float:
    """The angle in [0, pi] rad of that cosine, within 7e-16 of the exact value.

    Newton's iteration on `sincos`: half the angle has the cosine and the sine below, and the error of a step is a
    third of the cube of the previous error.
    """
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


# The logarithm of 2 to twice the precision of a double.
LN_2 = 0.6931471805599453
LN_2_REST = 2.3190468138462996e-17
LOG2_E = 1.0 / LN_2

# Interpolates (exp(r) - 1 - r) / r^2 at the Chebyshev nodes of +-1.0001 ln(2) / 2, which leaves 4.1e-17 of exp(r) - 1;
# `tests/capsule_gym/test_elementary.py` derives it.
E_0, E_1, E_2, E_3 = 0.5000000000000001, 0.16666666666666669, 0.04166666666662413, 0.008333333333330062
E_4, E_5, E_6, E_7 = 0.0013888888917213717, 0.00019841269863053618, 2.4801521295954376e-05, 2.7557268459997064e-06
E_8, E_9 = 2.7620088445409746e-07, 2.510038549551032e-08

# From here on the hyperbolic tangent is 1 to the last digit.
FLAT = 20.0


def _define_power_of_two(typing_context: Any, shifted: Any) -> Any:
    from numba import types

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # The lowest digits of the sum become the exponent.
        integer = context.get_value_type(types.int64)
        exponent = builder.shl(builder.bitcast(arguments[0], integer), integer(52))
        one = integer(1023 << 52)
        return builder.bitcast(builder.add(exponent, one), context.get_value_type(types.float64))

    return types.float64(types.float64), generate


@intrinsic(_define_power_of_two)
def power_of_two(shifted: float) -> float:
    """2^n from n + ROUNDING, for whole n in +-1022."""
    (bits,) = struct.unpack("<Q", struct.pack("<d", shifted))
    (power,) = struct.unpack("<d", struct.pack("<Q", ((bits + 1023) << 52) % 2**64))
    return float(power)


def _define_bits(typing_context: Any, x: Any) -> Any:
    from numba import types

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(types.uint64))

    return types.uint64(types.float64), generate


@intrinsic(_define_bits)
def bits(x: float) -> np.uint64:
    """The 64 bits of a number."""
    return np.float64(x).view(np.uint64)


def _define_from_bits(typing_context: Any, word: Any) -> Any:
    from numba import types

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(types.float64))

    return types.float64(types.uint64), generate


@intrinsic(_define_from_bits)
def from_bits(word: np.uint64) -> float:
    """The number with these 64 bits."""
    return float(np.uint64(word).view(np.float64))


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
def decay(x: float) -> float:
    """e^-x for any x >= 0; beyond 700, where `exp` ends, it stays at 1e-304."""
    return exp(-min(x, 700.0))


@inlined
def tanh(x: float) -> float:
    """The hyperbolic tangent, within 4.3e-16 of the exact value relative to it."""
    size = abs(x)
    # NaN stays NaN.
    size = FLAT if size > FLAT else size
    scale, rest = _exponential(-2.0 * size)
    # exp(-2 |x|) - 1
    e = fma(scale, rest, scale - 1.0)
    return math.copysign(e / (e + 2.0), x)


@inlined
def log(x: float) -> float:
    """The natural logarithm of a positive, normal number, within 2.2e-16 of the exact value, beyond +-1 relative to it.

    Halley's iteration on `exp`, each step of which triples the digits. For any other number the result is meaningless.
    """
    mantissa, exponent = math.frexp(x)
    y = fma(float(exponent), LN_2, mantissa - 1.0)
    for _ in range(4):
        power = exp(y)
        y += 2.0 * (x - power) / (x + power)
    return y


@inlined
def clip(value: float, limit: float) -> float:
    """The value, kept within -limit to limit; NaN stays NaN."""
    return limit if value > limit else -limit if value < -limit else value


# Bits of a double: those of 1.0, of its fraction, their number, and those of 2^52. Unsigned, since in numba the sum of
# a signed and an unsigned integer is a float.
_ONE_BITS, _FRACTION, _FRACTION_SIZE = np.uint64(1023 << 52), np.uint64(2**52 - 1), np.uint64(52)
_WHOLE_BITS, _HALF_WORD, _LOW, _UNUSED = np.uint64(1075 << 52), np.uint64(32), np.uint64(2**32 - 1), np.uint64(20)
# Constants of SplitMix64.
_SHIFT_0, _SHIFT_1, _SHIFT_2 = np.uint64(30), np.uint64(27), np.uint64(31)
_FACTOR_0, _FACTOR_1 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@inlined
def scramble(word: np.uint64) -> np.uint64:
    """A word of which every bit depends on every bit of the given one: SplitMix64's mixing function."""
    word = (word ^ (word >> _SHIFT_0)) * _FACTOR_0
    word = (word ^ (word >> _SHIFT_1)) * _FACTOR_1
    return word ^ (word >> _SHIFT_2)


@inlined
def uniforms(word: np.uint64) -> tuple[float, float]:
    """Two numbers in [1, 2), multiples of 2^-32, from the halves of a random word."""
    first, second = (word >> _HALF_WORD) << _UNUSED, (word & _LOW) << _UNUSED
    return from_bits(first | _ONE_BITS), from_bits(second | _ONE_BITS)


@inlined
def normals(word: np.uint64) -> tuple[float, float]:
    """Two standard normal numbers from a random word: the method of Box and Muller, without branches."""
    first, second = uniforms(word)
    # The logarithm of u in (0, 1]: exponent and, between 1 / sqrt(2) and sqrt(2), fraction, within 1e-12.
    u = bits(2.0 - first)
    exponent = from_bits((u >> _FRACTION_SIZE) | _WHOLE_BITS) - (2.0**52 + 1023.0)
    fraction = from_bits((u & _FRACTION) | _ONE_BITS)
    large = fraction > math.sqrt(2.0)
    fraction, exponent = (0.5 * fraction, exponent + 1.0) if large else (fraction, exponent)
    s = (fraction - 1.0) / (fraction + 1.0)
    z = s * s
    series = fma(z, fma(z, fma(z, fma(z, fma(z, fma(z, 1 / 13, 1 / 11), 1 / 9), 1 / 7), 1 / 5), 1 / 3), 1.0)
    logarithm = fma(exponent, LN_2, 2.0 * s * series)
    radius = math.sqrt(max(0.0, -2.0 * logarithm))
    sine, cosine = sincos(TURN * (second - 1.5))
    return radius * cosine, radius * sine
