"""The elementary functions: errors compared with 40 digits, and the same bits at every level of
instructions.
"""

import math

import numpy as np
import pytest

from capsule_gym.core import _core, native
from capsule_gym.core.elementary import arccos, log, sincos

mpmath = pytest.importorskip("mpmath", exc_type=ImportError)
HALF_TURN = math.pi / 2


def sin(x):
    return sincos(x)[0]


def cos(x):
    return sincos(x)[1]


def exp(x):
    return native.evaluate("exp", x)[0]


def tanh(x):
    return native.evaluate("tanh", x)[0]


def numbers(seed, low, high, count):
    return np.random.default_rng(seed).uniform(low, high, count).tolist()


def quarters(turns):
    """Multiples of pi / 2, where a function vanishes or the turn changes, and their neighbours."""
    exact = 0.5 * math.pi * np.arange(-4 * turns, 4 * turns + 1)
    above = np.nextafter(exact, math.inf)
    below = np.nextafter(exact, -math.inf)
    return np.concatenate([exact, above, below]).tolist()


ANGLES = [*numbers(7, -HALF_TURN, HALF_TURN, 2000), *numbers(8, -1e4, 1e4, 2000), *quarters(20)]
ANGLES += [0.0, -0.0, 5e-324, 1e15]
SMALL = np.array([*numbers(7, -30.0, 30.0, 2000), *numbers(8, -1.0, 1.0, 2000), 0.0, -0.0, 1e-310])


@pytest.fixture(params=_core.LEVELS)
def level(request, select_level):
    select_level(request.param)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sincos", np.array(ANGLES)),
        ("exp", SMALL),
        ("tanh", SMALL),
        ("log", 1e-300 + np.abs(SMALL)),
    ],
)
def test_every_level_gives_the_same_bits(name, values, select_level):
    expected = np.array(native.evaluate(name, values)).tobytes()
    for level in _core.LEVELS:
        select_level(level)
        assert np.array(native.evaluate(name, values)).tobytes() == expected, level


@pytest.mark.usefixtures("level")
def test_tanh_is_odd():
    assert (tanh(-SMALL) == -tanh(SMALL)).all()


@pytest.mark.usefixtures("level")
def test_tanh_stays_within_one():
    assert (np.abs(tanh(SMALL)) <= 1.0).all()
    assert tanh(math.inf) == 1.0


@pytest.mark.usefixtures("level")
def test_an_undefined_value_is_nan():
    assert np.isnan(sincos([math.nan, math.inf])).all()
    assert math.isnan(tanh(math.nan))


@pytest.mark.usefixtures("level")
def test_the_layout_of_an_array_does_not_change_its_bits():
    table = np.reshape(ANGLES[:4000], (4, 1000))
    assert sin(table.T[1::2]).tolist() == sin(table).T[1::2].tolist()


@pytest.mark.usefixtures("level")
def test_a_number_gives_arrays_without_dimensions():
    assert [part.shape for part in sincos(np.float64(0.5))] == [(), ()]


def absolute(exact):
    return 1.0


def relative(exact):
    return abs(exact)


def relative_beyond_one(exact):
    return max(1.0, abs(exact))


TINY = (10.0 ** np.arange(-300, 0, 3.7)).tolist()
NEAR_ONE = [1.0 - 10.0**power for power in numbers(11, -17.0, 0.0, 250)]
# The last angles have the largest errors of ten million, of sin near 0 and of cos far away.
NEAR = [*numbers(0, -HALF_TURN, HALF_TURN, 1500), HALF_TURN, -HALF_TURN, 1.5515752168417596]
FAR = [*numbers(1, -10.0, 10.0, 2000), *numbers(2, -1e4, 1e4, 1500), *quarters(20)]
FAR += [-1e4, 1e4, 3.111995651295123]
POWERS = [*numbers(0, -2.0, 2.0, 3000), *numbers(1, -708.0, 708.0, 3000), -708.0, 708.0]
POWERS += [0.36194805464755997, -29.44537109825084]
ARGUMENTS = [*numbers(2, -1.0, 1.0, 3000), *numbers(3, -21.0, 21.0, 3000), *TINY]
ARGUMENTS += [0.17385258259706, 0.17331649703049387]
POSITIVE = [*numbers(5, 0.5, 2.0, 1000), *TINY, 60.0]
COSINES = [*numbers(12, -1.0, 1.0, 2000), *NEAR_ONE, *np.negative(NEAR_ONE).tolist()]
COSINES += [-1.0, 0.0, -0.8581085261434456]


@pytest.mark.parametrize(
    ("function", "exact", "size", "error", "points"),
    [
        (sin, mpmath.sin, absolute, 3.4e-16, NEAR),
        (cos, mpmath.cos, absolute, 2.2e-16, NEAR),
        (sin, mpmath.sin, absolute, 4.5e-16, FAR),
        (cos, mpmath.cos, absolute, 1.2e-15, FAR),
        (exp, mpmath.exp, relative, 1.7e-16, POWERS),
        (tanh, mpmath.tanh, relative, 4.3e-16, ARGUMENTS),
        (log, mpmath.log, relative_beyond_one, 2.2e-16, POSITIVE),
        (arccos, mpmath.acos, absolute, 7e-16, COSINES),
    ],
)
def test_the_largest_error_is_that_of_ten_million_numbers(function, exact, size, error, points):
    largest = 0.0
    with mpmath.workdps(40):
        for x in points:
            wanted = exact(mpmath.mpf(x))
            largest = max(largest, abs(function(x) - wanted) / size(wanted))
    assert 0.6 * error < largest <= error


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_exp_of_zero_is_exact(zero):
    assert exp(zero) == 1.0


def test_functions_of_one_are_exact():
    assert arccos(1.0) == 0.0
    assert exp(log(1.0)) == 1.0
