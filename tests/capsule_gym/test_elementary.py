"""The elementary functions: errors compared with 40 digits, and the same bits at every level of instructions."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

import capsule_gym
from capsule_gym import _core, native
from capsule_gym.elementary import arccos, exp, log, sincos, tanh

mpmath = pytest.importorskip("mpmath", exc_type=ImportError)

HEADER = Path(capsule_gym.__file__).with_name("core") / "elementary.hpp"
HALF_TURN = math.pi / 2
# Largest errors of ten million random angles of each range, to the last digit.
NEAR_ERROR, FAR_ERROR = 3.4e-16, 1.2e-15
# The angles with the largest errors.
NEAR_WORST, FAR_WORST = 1.5515752168417596, 3.111995651295123


def angles(seed: int, limit: float, count: int) -> list[float]:
    return np.random.default_rng(seed).uniform(-limit, limit, count).tolist()


def quarters(turns: int) -> list[float]:
    """Multiples of pi / 2, where either function vanishes or the reduction changes the turn, and their neighbours."""
    exact = 0.5 * math.pi * np.arange(-4 * turns, 4 * turns + 1)
    return [*exact.tolist(), *np.nextafter(exact, math.inf).tolist(), *np.nextafter(exact, -math.inf).tolist()]


def largest_error(points: list[float]) -> float:
    """The largest error of either function, compared with 40 digits."""
    worst = 0.0
    with mpmath.workdps(40):
        for angle, *found in zip(points, *(part.tolist() for part in sincos(points)), strict=True):
            errors = (abs(float(a - b)) for a, b in zip(found, (mpmath.sin(angle), mpmath.cos(angle)), strict=True))
            worst = max(worst, *errors)
    return worst


def test_errors_stay_within_an_ulp_or_two():
    near = [*angles(0, HALF_TURN, 1500), HALF_TURN, -HALF_TURN, NEAR_WORST]
    assert 0.95 * NEAR_ERROR < largest_error(near) <= NEAR_ERROR
    far = [*angles(1, 10.0, 2000), *angles(2, 1e4, 1500), *quarters(20), -1e4, 1e4, FAR_WORST]
    assert 0.95 * FAR_ERROR < largest_error(far) <= FAR_ERROR


@pytest.mark.parametrize("level", _core.LEVELS)
def test_every_level_gives_the_same_bits_in_every_form_of_array(level):
    values = np.array([*angles(7, HALF_TURN, 2000), *angles(8, 1e4, 2000), *quarters(20), 0.0, -0.0, 5e-324, 1e15])
    small = np.array([*numbers(7, -30.0, 30.0, 2000), *numbers(8, -1.0, 1.0, 2000), 0.0, -0.0, 1e-310])
    given = {"sincos": values, "exp": small, "tanh": small, "log": 1e-300 + np.abs(small)}
    expected = {name: native.evaluate(name, array) for name, array in given.items()}
    _core.select_level(level)
    try:
        results = {name: native.evaluate(name, array) for name, array in given.items()}
    finally:
        _core.select_level(native.LEVEL)
    for name, parts in results.items():
        for found, whole in zip(parts, expected[name], strict=True):
            assert found.tobytes() == whole.tobytes(), name
    assert (tanh(-small) == -tanh(small)).all() and (np.abs(tanh(small)) <= 1.0).all()
    assert np.isnan(sincos([math.nan, math.inf])).all()
    assert math.isnan(tanh(math.nan)) and tanh(math.inf) == 1.0
    table = values[:4000].reshape(4, 1000)
    assert sincos(table.T[1::2])[0].tolist() == sincos(table)[0].T[1::2].tolist()
    assert [part.shape for part in sincos(np.float64(0.5))] == [(), ()]


def test_arccos_inverts_the_cosine():
    rng = np.random.default_rng(11)
    near_one = 10.0 ** rng.uniform(-17.0, 0.0, 500)
    cosines = [*rng.uniform(-1.0, 1.0, 2000), *(1.0 - near_one), *(near_one - 1.0), -1.0, 1.0, 0.0, -0.8581085261434456]
    with mpmath.workdps(40):
        errors = [abs(float(arccos(c) - mpmath.acos(mpmath.mpf(c)))) for c in map(float, cosines)]
    assert 0.9 * 7e-16 < max(errors) <= 7e-16
    assert arccos(1.0) == 0.0


def coefficients(letter: str) -> list[float]:
    """The constants S_0, S_1, .. of the header, by their first letter."""
    return [float(value) for value in re.findall(rf"\b{letter}_\d = ([^,;]+)[,;]", HEADER.read_text("utf-8"))]


def polynomial(function) -> list[float]:
    """The coefficients of degree 0 to 7 that interpolate a function of z at the Chebyshev nodes of its range."""
    count = 8
    widest = (mpmath.pi / 2 * mpmath.mpf("1.0001")) ** 2
    nodes = [widest * (1 + mpmath.cos(mpmath.pi * (2 * k + 1) / (2 * count))) / 2 for k in range(count)]
    powers = mpmath.matrix([[z**degree for degree in range(count)] for z in nodes])
    return [float(c) for c in mpmath.lu_solve(powers, mpmath.matrix([function(z) for z in nodes]))]


def test_the_coefficients_are_the_interpolation_that_the_header_names():
    with mpmath.workdps(60):
        sine = polynomial(lambda z: (mpmath.sin(mpmath.sqrt(z)) / mpmath.sqrt(z) - 1) / z)
        cosine = polynomial(lambda z: (mpmath.cos(mpmath.sqrt(z)) - 1 + z / 2) / z**2)
    assert (sine, cosine) == (coefficients("S"), coefficients("C"))


# Largest errors of ten million random numbers, relative to the exact value, and the numbers with these errors.
EXP_ERROR, TANH_ERROR, LOG_ERROR = 1.7e-16, 4.3e-16, 2.2e-16
EXP_WORST, TANH_WORST = (0.36194805464755997, -29.44537109825084), (0.17385258259706, 0.17331649703049387)


def numbers(seed: int, low: float, high: float, count: int) -> list[float]:
    return np.random.default_rng(seed).uniform(low, high, count).tolist()


def relative_error(function, exact, points) -> float:
    """The largest error relative to the exact value, compared with 40 digits."""
    with mpmath.workdps(40):
        return max(abs(float(function(x) / exact(x) - 1)) for x in map(mpmath.mpf, points))


def test_exp_is_within_an_ulp():
    points = [*numbers(0, -2.0, 2.0, 3000), *numbers(1, -708.0, 708.0, 3000), *EXP_WORST, -708.0, 708.0]
    assert 0.9 * EXP_ERROR < relative_error(lambda x: mpmath.mpf(exp(float(x))), mpmath.exp, points) <= EXP_ERROR
    assert exp(0.0) == exp(-0.0) == 1.0


def test_tanh_is_within_two_ulps():
    tiny = (10.0 ** np.arange(-300, 0, 3.7)).tolist()
    points = [*numbers(2, -1.0, 1.0, 3000), *numbers(3, -21.0, 21.0, 3000), *tiny, *TANH_WORST]
    assert 0.9 * TANH_ERROR < relative_error(lambda x: mpmath.mpf(tanh(float(x))), mpmath.tanh, points) <= TANH_ERROR


def test_log_inverts_exp():
    points = [*numbers(5, 0.5, 2.0, 1000), *(10.0 ** np.random.default_rng(6).uniform(-300, 300, 1000)).tolist(), 60.0]
    with mpmath.workdps(40):
        for x in points:
            exact = mpmath.log(mpmath.mpf(x))
            assert abs(log(x) - exact) <= LOG_ERROR * max(1.0, abs(exact))
    assert exp(log(1.0)) == 1.0


def test_the_coefficients_of_exp_are_the_interpolation_that_the_header_names():
    count = 10
    with mpmath.workdps(60):
        widest = mpmath.log(2) / 2 * mpmath.mpf("1.0001")
        nodes = [widest * mpmath.cos(mpmath.pi * (2 * k + 1) / (2 * count)) for k in range(count)]
        powers = mpmath.matrix([[r**degree for degree in range(count)] for r in nodes])
        values = mpmath.matrix([(mpmath.expm1(r) - r) / r**2 for r in nodes])
        found = [float(c) for c in mpmath.lu_solve(powers, values)]
        assert found == coefficients("E")
        for r in [widest * mpmath.mpf(k) / 300 for k in range(-300, 301) if k]:
            polynomial = r + r * r * sum(c * r**degree for degree, c in enumerate(map(mpmath.mpf, found)))
            assert abs(polynomial / mpmath.expm1(r) - 1) < 4.2e-17
