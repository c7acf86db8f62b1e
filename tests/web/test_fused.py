"""The fused multiply-add out of integers against exact fractions."""

from __future__ import annotations

import itertools
import math
import sys
from fractions import Fraction

import numpy as np
import pytest

from web.fused import fused

SPECIAL = (
    *(
        0.0,
        1.0,
        0.5,
        1.5,
        3.0,
        1.0 + 2.0**-52,
        1.0 - 2.0**-53,
        5e-324,
        3e-320,
        sys.float_info.min,
        2.0**-537,
        2.0**-538,
    ),
    *(sys.float_info.min, sys.float_info.min * (1.0 - 2.0**-52), 2.0**511, 2.0**512, sys.float_info.max, math.inf),
)


def exact(a: float, b: float, c: float) -> float:
    """a b + c rounded once, by fractions."""
    if math.isfinite(a) and math.isfinite(b) and not math.isfinite(c):
        return c
    if not (math.isfinite(a) and math.isfinite(b)):
        return a * b + c
    value = Fraction(a) * Fraction(b) + Fraction(c)
    if value == 0:
        # Of zeros IEEE says the sign; of what cancels it is plus.
        return a * b + c if 0.0 in (a, b) else 0.0
    try:
        rounded = float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    return rounded if rounded else math.copysign(0.0, value)


def same(first: float, second: float) -> bool:
    """Whether two doubles are the same bits, or both no number."""
    return np.float64(first).tobytes() == np.float64(second).tobytes() or (math.isnan(first) and math.isnan(second))


def draw(case: str, rng: np.random.Generator, count: int) -> list[tuple[float, float, float]]:
    """Triples of a kind."""

    def sized(low: int, high: int) -> np.ndarray:
        sign = rng.choice([-1.0, 1.0], count)
        return sign * (1.0 + rng.random(count)) * 2.0 ** rng.integers(low, high, count)

    a, b = sized(-3, 4), sized(-3, 4)
    if case == "any bits":
        words = rng.integers(0, 2**64, (3, count), dtype=np.uint64).view(np.float64)
        a, b, c = words
    elif case == "ordinary":
        c = sized(-110, 111)
    elif case == "cancelling":
        c = -a * b * (1.0 + rng.integers(-3, 4, count) * 2.0**-52)
    elif case == "subnormal":
        a, b, c = sized(-545, -500), sized(-545, -500), sized(-1074, -1010)
    else:
        a, b, c = sized(500, 520), sized(500, 520), sized(1000, 1023)
    return list(zip(a.tolist(), b.tolist(), c.tolist(), strict=True))


@pytest.mark.parametrize("case", ["any bits", "ordinary", "cancelling", "subnormal", "huge"])
def test_random_triples_are_rounded_once(case: str) -> None:
    rng = np.random.default_rng(3)
    wrong = [triple for triple in draw(case, rng, 4000) if not same(fused(*triple), exact(*triple))]
    assert not wrong


def test_special_triples_are_rounded_once() -> None:
    values = [sign * value for value in SPECIAL for sign in (1.0, -1.0)] + [math.nan]
    wrong = [triple for triple in itertools.product(values, repeat=3) if not same(fused(*triple), exact(*triple))]
    assert not wrong


def test_a_product_and_a_sum_would_round_twice() -> None:
    a = 1.0 + 2.0**-30
    assert fused(a, a, -1.0) == 2.0**-29 + 2.0**-60 != a * a - 1.0
