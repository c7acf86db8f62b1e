"""Exponential, logarithm and hyperbolic tangent: how exact they are, and that compiled code computes the same bits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import njit

from capsule_gym import exponential
from capsule_gym.compilation import fingerprint
from capsule_gym.exponential import exp, log, power_of_two, tanh
from capsule_gym.trigonometry import ROUNDING

mpmath = pytest.importorskip("mpmath", exc_type=ImportError)

# What ten million random numbers did not exceed, relative to the exact value, and those that came closest.
EXP_ERROR, TANH_ERROR, LOG_ERROR = 1.7e-16, 4.3e-16, 2.2e-16
EXP_WORST, TANH_WORST = (0.36194805464755997, -29.44537109825084), (0.17385258259706, 0.17331649703049387)

compiled_exp, compiled_tanh = njit(exp), njit(tanh)


def numbers(seed: int, low: float, high: float, count: int) -> list[float]:
    return np.random.default_rng(seed).uniform(low, high, count).tolist()


def largest_error(function, exact, points) -> float:
    """Relative to the exact value, against 40 digits."""
    with mpmath.workdps(40):
        return max(abs(float(function(x) / exact(x) - 1)) for x in map(mpmath.mpf, points))


def test_exp_is_within_an_ulp():
    points = [*numbers(0, -2.0, 2.0, 3000), *numbers(1, -708.0, 708.0, 3000), *EXP_WORST, -708.0, 708.0]
    assert 0.9 * EXP_ERROR < largest_error(lambda x: mpmath.mpf(exp(float(x))), mpmath.exp, points) <= EXP_ERROR
    assert exp(0.0) == exp(-0.0) == 1.0


def test_tanh_is_within_two_ulps():
    tiny = (10.0 ** np.arange(-300, 0, 3.7)).tolist()
    points = [*numbers(2, -1.0, 1.0, 3000), *numbers(3, -21.0, 21.0, 3000), *tiny, *TANH_WORST]
    assert 0.9 * TANH_ERROR < largest_error(lambda x: mpmath.mpf(tanh(float(x))), mpmath.tanh, points) <= TANH_ERROR


def test_tanh_is_odd_and_stays_within_one():
    for x in [*numbers(4, 0.0, 25.0, 2000), 0.0, 1e-300, 20.0, 1e300, math.inf]:
        assert tanh(-x) == -tanh(x)
        assert 0.0 <= tanh(x) <= 1.0
    assert math.copysign(1.0, tanh(-0.0)) == -1.0
    assert tanh(20.0) == tanh(1e300) == tanh(math.inf) == 1.0
    assert math.isnan(tanh(math.nan))
    assert math.isnan(compiled_tanh(math.nan))


def test_tanh_grows():
    values = np.array([tanh(x) for x in np.linspace(-3.0, 3.0, 20001).tolist()])
    assert (np.diff(values) > 0.0).all()


def test_log_inverts_exp():
    points = [*numbers(5, 0.5, 2.0, 1000), *(10.0 ** np.random.default_rng(6).uniform(-300, 300, 1000)).tolist(), 60.0]
    with mpmath.workdps(40):
        for x in points:
            exact = mpmath.log(mpmath.mpf(x))
            assert abs(log(x) - exact) <= LOG_ERROR * max(1.0, abs(exact))
    assert exp(log(1.0)) == 1.0


@pytest.mark.parametrize("x", [0.0, -1.0, math.inf, math.nan])
def test_what_has_no_logarithm_is_refused(x):
    with pytest.raises(ValueError, match=r"x must be a finite number > 0, got"):
        log(x)


def test_powers_of_two_are_exact():
    for n in range(-1022, 1023):
        assert power_of_two(n + ROUNDING) == math.ldexp(1.0, n)


def test_compiled_and_interpreted_functions_are_equal_bit_for_bit():
    for x in [*numbers(7, -30.0, 30.0, 2000), *numbers(8, -1.0, 1.0, 2000), 0.0, -0.0, 1e-310]:
        assert np.array([exp(x), tanh(x)]).tobytes() == np.array([compiled_exp(x), compiled_tanh(x)]).tobytes()


def test_the_coefficients_are_the_interpolation_that_the_module_names():
    count = 10
    with mpmath.workdps(60):
        widest = mpmath.log(2) / 2 * mpmath.mpf("1.0001")
        nodes = [widest * mpmath.cos(mpmath.pi * (2 * k + 1) / (2 * count)) for k in range(count)]
        powers = mpmath.matrix([[r**degree for degree in range(count)] for r in nodes])
        values = mpmath.matrix([(mpmath.expm1(r) - r) / r**2 for r in nodes])
        found = [float(c) for c in mpmath.lu_solve(powers, values)]
        assert found == [getattr(exponential, f"E_{degree}") for degree in range(count)]
        for r in [widest * mpmath.mpf(k) / 300 for k in range(-300, 301) if k]:
            polynomial = r + r * r * sum(c * r**degree for degree, c in enumerate(map(mpmath.mpf, found)))
            assert abs(polynomial / mpmath.expm1(r) - 1) < 4.2e-17


def test_the_logarithm_of_two_is_known_to_twice_the_precision_of_a_double():
    with mpmath.workdps(50):
        assert abs(mpmath.mpf(exponential.LN_2) + mpmath.mpf(exponential.LN_2_REST) - mpmath.log(2)) < 1e-32
        assert exponential.LOG2_E == float(1 / mpmath.log(2))


@pytest.mark.parametrize("name", [name for name, value in vars(exponential).items() if isinstance(value, float)])
def test_an_edit_of_any_constant_changes_the_fingerprint(name, monkeypatch):
    before = fingerprint(tanh)
    monkeypatch.setattr(exponential, name, getattr(exponential, name) * 1.0000001)
    assert fingerprint(tanh) != before
