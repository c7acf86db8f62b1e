"""The elementary functions: errors compared with 40 digits, and the same bits at every level of
instructions."""

import math

import numpy as np
import pytest

from capsule_gym.core import _core, native
from capsule_gym.core.elementary import arccos, log, sincos

mpmath = pytest.importorskip("mpmath", exc_type=ImportError)
HALF_TURN = math.pi / 2
exp, tanh = (lambda x, name=name: native.evaluate(name, x)[0] for name in ("exp", "tanh"))


def numbers(seed, low, high, count):
    return np.random.default_rng(seed).uniform(low, high, count).tolist()


def quarters(turns):
    """Multiples of pi / 2, where either function vanishes or the reduction changes the turn, and
    their neighbours."""
    exact = 0.5 * math.pi * np.arange(-4 * turns, 4 * turns + 1)
    return [
        *exact.tolist(),
        *np.nextafter(exact, math.inf).tolist(),
        *np.nextafter(exact, -math.inf).tolist(),
    ]


@pytest.mark.parametrize("level", _core.LEVELS)
def test_every_level_gives_the_same_bits_in_every_form_of_array(level, select_level):
    angles = [*numbers(7, -HALF_TURN, HALF_TURN, 2000), *numbers(8, -1e4, 1e4, 2000)]
    values = np.array([*angles, *quarters(20), 0.0, -0.0, 5e-324, 1e15])
    small = np.array(
        [*numbers(7, -30.0, 30.0, 2000), *numbers(8, -1.0, 1.0, 2000), 0.0, -0.0, 1e-310]
    )
    given = {"sincos": values, "exp": small, "tanh": small, "log": 1e-300 + np.abs(small)}
    expected = {name: native.evaluate(name, array) for name, array in given.items()}
    select_level(level)
    for name, array in given.items():
        for found, whole in zip(native.evaluate(name, array), expected[name], strict=True):
            assert found.tobytes() == whole.tobytes(), name
    assert (tanh(-small) == -tanh(small)).all() and (np.abs(tanh(small)) <= 1.0).all()
    assert np.isnan(sincos([math.nan, math.inf])).all()
    assert math.isnan(tanh(math.nan)) and tanh(math.inf) == 1.0
    table = values[:4000].reshape(4, 1000)
    assert sincos(table.T[1::2])[0].tolist() == sincos(table)[0].T[1::2].tolist()
    assert [part.shape for part in sincos(np.float64(0.5))] == [(), ()]


TINY = (10.0 ** np.arange(-300, 0, 3.7)).tolist()
NEAR_ONE = [
    sign * (1.0 - 10.0**power) for sign in (-1.0, 1.0) for power in numbers(11, -17.0, 0.0, 250)
]
# The last angles have the largest errors of ten million, of sin near 0 and of cos far away.
NEAR = [*numbers(0, -HALF_TURN, HALF_TURN, 1500), HALF_TURN, -HALF_TURN, 1.5515752168417596]
FAR = [
    *numbers(1, -10.0, 10.0, 2000),
    *numbers(2, -1e4, 1e4, 1500),
    *quarters(20),
    -1e4,
    1e4,
    3.111995651295123,
]
# Function, exact function, what errors are relative to, the largest of ten million numbers, and
# numbers with such.
ERRORS = {
    "sin": (lambda x: sincos(x)[0], mpmath.sin, lambda exact: 1.0, 3.4e-16, NEAR),
    "cos": (lambda x: sincos(x)[1], mpmath.cos, lambda exact: 1.0, 2.2e-16, NEAR),
    "sin, far": (lambda x: sincos(x)[0], mpmath.sin, lambda exact: 1.0, 4.5e-16, FAR),
    "cos, far": (lambda x: sincos(x)[1], mpmath.cos, lambda exact: 1.0, 1.2e-15, FAR),
    "exp": (exp, mpmath.exp, abs, 1.7e-16, [*numbers(0, -2.0, 2.0, 3000), *numbers(1, -708.0, 708.0, 3000),
        0.36194805464755997, -29.44537109825084, -708.0, 708.0]),
    "tanh": (tanh, mpmath.tanh, abs, 4.3e-16, [*numbers(2, -1.0, 1.0, 3000), *numbers(3, -21.0, 21.0, 3000), *TINY,
        0.17385258259706, 0.17331649703049387]),
    "log": (log, mpmath.log, lambda exact: max(1.0, abs(exact)), 2.2e-16, [*numbers(5, 0.5, 2.0, 1000), *TINY, 60.0]),
    "arccos": (arccos, mpmath.acos, lambda exact: 1.0, 7e-16, [*numbers(12, -1.0, 1.0, 2000), *NEAR_ONE, -1.0, 0.0,
        -0.8581085261434456]),
}  # fmt: skip


@pytest.mark.parametrize(
    ("function", "exact", "size", "error", "points"), ERRORS.values(), ids=ERRORS
)
def test_errors_stay_below_those_of_ten_million_numbers(function, exact, size, error, points):
    with mpmath.workdps(40):
        pairs = ((function(x), exact(mpmath.mpf(x))) for x in points)
        assert (
            0.6 * error
            < max(abs(found - wanted) / size(wanted) for found, wanted in pairs)
            <= error
        )
    assert (exp(0.0), exp(-0.0), arccos(1.0), exp(log(1.0))) == (1.0, 1.0, 0.0, 1.0)
