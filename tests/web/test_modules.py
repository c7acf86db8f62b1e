"""Parts of the live page's build: WebAssembly modules, the fused multiply-add."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

from web import modules
from web.fused import fused

# --- WebAssembly -----------------------------------------------------------------------------------------------------


def test_a_module_is_the_same_bytes_for_another_processor() -> None:
    code = (
        "import sys; from web import modules; sys.stdout.buffer.write(modules.build(['common'], cache=None)['common'])"
    )
    others = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    command = [sys.executable, "-c", code]
    built = subprocess.run(command, env={**os.environ, **others}, cwd=modules.ROOT, check=True, capture_output=True)
    first = modules.build([modules.COMMON], cache=None)[modules.COMMON]
    assert built.stdout == first and first.startswith(b"\0asm\1\0\0\0")


# --- fused multiply-add ----------------------------------------------------------------------------------------------


def exact(a: float, b: float, c: float) -> float:
    """a b + c rounded once, computed with fractions."""
    value = Fraction(a) * Fraction(b) + Fraction(c)
    return float(value) if value else a * b + c if 0.0 in (a, b) else 0.0


def triples(case: str) -> np.ndarray:
    """Triples of a kind, one per column."""
    rng, count = np.random.default_rng(3), 4000

    def sized(low: int, high: int, places: int = 52) -> np.ndarray:
        fraction = 1.0 + np.floor(rng.random(count) * 2.0**places) / 2.0**places
        return rng.choice([-1.0, 1.0], count) * fraction * 2.0 ** rng.integers(low, high, count)

    if case == "zeros":
        return np.array(list(itertools.product((0.0, -0.0, 1.5, -1.5, 2.0**-400, 2.0**400), repeat=3))).T
    if case == "halves":
        # With few digits a sum often lies halfway between two numbers.
        return np.array((sized(-3, 4, 3), 1.0 + rng.integers(0, 4, count) * 2.0**-52, sized(-60, 60, 3)))
    if case == "any size":
        return np.array((sized(-400, 400), sized(-400, 400), sized(-1074, 900)))
    a, b = sized(-3, 4), sized(-3, 4)
    return np.array(
        (a, b, -a * b * (1.0 + rng.integers(-3, 4, count) * 2.0**-52) if case == "cancel" else sized(-110, 111))
    )


@pytest.mark.parametrize("case", ["ordinary", "cancel", "halves", "any size", "zeros"])
def test_products_and_sums_are_rounded_once(case: str) -> None:
    found = np.array([(fused(*triple), exact(*triple)) for triple in triples(case).T.tolist()])
    assert np.array_equal(found[:, 0].view(np.uint64), found[:, 1].view(np.uint64))


def test_infinite_and_undefined_numbers_stay_so() -> None:
    assert fused(math.inf, -2.0, 1.0) == -math.inf and fused(1.0, 2.0, math.inf) == math.inf
    assert math.isnan(fused(math.inf, 0.0, 1.0)) and math.isnan(fused(math.inf, 1.0, -math.inf))
