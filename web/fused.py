"""The fused multiply-add out of integers, for processors that have none: WebAssembly is one.

The same bits as the instruction of other processors for any three doubles, but for which NaN a NaN is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from capsule_gym.compilation import inlined

# Of a double: the bits of the fraction, the bit before them, the largest exponent, and where the sign stands.
FRACTION = np.uint64(2**52 - 1)
LEADING = np.uint64(2**52)
LARGEST = 2047
SIGN = np.uint64(63)
# Such a number of bits lies behind the point of a significand; what the exponent counts from.
POINT, BIAS = 52, 1023
# Zeros behind the product and behind c that bring both to the same place, two bits below the top of two words.
PRODUCT_ROOM, C_ROOM = 20, 72
# The bits of the upper word behind a significand at its top.
REST = np.uint64(11)
REST_MASK, HALF = np.uint64(2**11 - 1), np.uint64(2**10)
# Where a significand is cut in two for its product.
CUT = np.uint64(27)
CUT_MASK, TWO_CUTS, TWO_CUTS_MASK = np.uint64(2**27 - 1), np.uint64(54), np.uint64(2**54 - 1)
_ZERO, _ONE = np.uint64(0), np.uint64(1)


@intrinsic
def _as_bits(typing_context: Any, value: Any) -> Any:
    """The bits of a double."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(types.uint64))

    return types.uint64(types.float64), generate


@intrinsic
def _as_double(typing_context: Any, bits: Any) -> Any:
    """The double of these bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(types.float64))

    return types.float64(types.uint64), generate


@intrinsic
def _leading_zeros(typing_context: Any, word: Any) -> Any:
    """How many zeros a word that is not 0 begins with."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctlz(arguments[0], context.get_value_type(types.boolean)(1))

    return types.int64(types.uint64), generate


@inlined
def _significand(bits: np.uint64) -> tuple[np.uint64, int]:
    """Significand with the leading bit at POINT, and exponent, of a double that is neither 0 nor infinite nor NaN."""
    exponent = np.int64(bits >> np.uint64(POINT)) & LARGEST
    fraction = bits & FRACTION
    if exponent > 0:
        return fraction | LEADING, exponent
    shift = _leading_zeros(fraction) - (63 - POINT)
    return fraction << np.uint64(shift), 1 - shift


@inlined
def _product(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """The product of two significands in two words.

    Cut in halves of a word, as it is usual, LLVM makes one product of 128 bits of it, which WebAssembly does not have.
    """
    a_0, a_1, b_0, b_1 = a & CUT_MASK, a >> CUT, b & CUT_MASK, b >> CUT
    middle = a_1 * b_0 + a_0 * b_1
    low = a_0 * b_0 + ((middle & CUT_MASK) << CUT)
    high = a_1 * b_1 + (middle >> CUT) + (low >> TWO_CUTS)
    return high >> np.uint64(10), high << TWO_CUTS | low & TWO_CUTS_MASK


@inlined
def _shifted(high: np.uint64, low: np.uint64, count: int) -> tuple[np.uint64, np.uint64]:
    """Two words moved down by that many bits; what falls off sets the last bit, so that rounding still sees it."""
    if count == 0:
        return high, low
    if count < 64:
        down, up = np.uint64(count), np.uint64(64 - count)
        lost = _ONE if low << up != _ZERO else _ZERO
        return high >> down, low >> down | high << up | lost
    if count == 64:
        return _ZERO, high | (_ONE if low != _ZERO else _ZERO)
    if count < 128:
        down, up = np.uint64(count - 64), np.uint64(128 - count)
        lost = _ONE if high << up | low != _ZERO else _ZERO
        return _ZERO, high >> down | lost
    return _ZERO, _ONE if high | low != _ZERO else _ZERO


@inlined
def _rounded(negative: np.uint64, high: np.uint64, low: np.uint64, exponent: int) -> float:
    """The double nearest to a number of two words that is not 0, half to even.

    Args:
        negative: 1 or 0.
        high: upper word.
        low: lower word.
        exponent: of the lowest bit.
    """
    if high == _ZERO:
        high, low, exponent = low, _ZERO, exponent - 64
    zeros = _leading_zeros(high)
    if zeros > 0:
        up = np.uint64(zeros)
        high, low = high << up | low >> np.uint64(64 - zeros), low << up
    biased = exponent - zeros + 127 + BIAS
    if biased >= LARGEST:
        return _as_double(negative << SIGN | np.uint64(LARGEST) << np.uint64(POINT))
    if biased < 1:
        high, low = _shifted(high, low, 1 - biased)
        biased = 1
    kept, rest = high >> REST, high & REST_MASK
    if rest > HALF or (rest == HALF and (low != _ZERO or kept & _ONE != _ZERO)):
        kept += _ONE
    # The leading bit, where there is one, counts the exponent up; so does a carry of the rounding.
    return _as_double((negative << SIGN) + (np.uint64(biased - 1) << np.uint64(POINT)) + kept)


@njit
def fused(a: float, b: float, c: float) -> float:
    """a b + c, rounded once."""
    x, y, z = _as_bits(a), _as_bits(b), _as_bits(c)
    mask = np.uint64(LARGEST)
    infinite = x >> np.uint64(POINT) & mask == mask or y >> np.uint64(POINT) & mask == mask
    # The product is exact then.
    if infinite or a == 0.0 or b == 0.0:
        return a * b + c
    if z >> np.uint64(POINT) & mask == mask:
        return c
    if c == 0.0:
        return a * b
    m_a, e_a = _significand(x)
    m_b, e_b = _significand(y)
    m_c, e_c = _significand(z)
    high, low = _product(m_a, m_b)
    high = high << np.uint64(PRODUCT_ROOM) | low >> np.uint64(64 - PRODUCT_ROOM)
    low = low << np.uint64(PRODUCT_ROOM)
    high_c, low_c = m_c << np.uint64(C_ROOM - 64), _ZERO
    # Of the lowest bits.
    exponent, exponent_c = e_a + e_b - 2 * (BIAS + POINT) - PRODUCT_ROOM, e_c - (BIAS + POINT) - C_ROOM
    # Where two numbers nearly cancel they are shifted by so little that only zeros fall off.
    if exponent >= exponent_c:
        high_c, low_c = _shifted(high_c, low_c, exponent - exponent_c)
    else:
        high, low = _shifted(high, low, exponent_c - exponent)
        exponent = exponent_c
    negative, negative_c = (x ^ y) >> SIGN, z >> SIGN
    if negative == negative_c:
        total = low + low_c
        return _rounded(negative, high + high_c + (_ONE if total < low else _ZERO), total, exponent)
    if high < high_c or (high == high_c and low < low_c):
        high, low, high_c, low_c, negative = high_c, low_c, high, low, negative_c
    high, low = high - high_c - (_ONE if low < low_c else _ZERO), low - low_c
    if high | low == _ZERO:
        return 0.0
    return _rounded(negative, high, low, exponent)
