"""What is recomputed of the adaptive law along a run: its terms, the Lyapunov function and why it rises."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.laws.adaptive import adaptive, adaptive_as_published, nominal_estimates
from baselines.laws.gains import PUBLISHED, REGULARISED
from baselines.paper.adaptation import RecordedTerms, derivative, descent, law_terms, lyapunov
from baselines.paper.traces import trace, traces
from capsule_gym import Capsule

PLANT = Capsule().plant()


@pytest.mark.parametrize("regularised", [True, False])
def test_recomputed_terms_are_those_of_the_law(regularised):
    controller = adaptive() if regularised else adaptive_as_published()
    for run in traces(controller, [(0.5, 0.01), (0.45, 0.011)], cycles=2):
        terms = law_terms(run, regularised=regularised)
        # The same functions: no digit may differ.
        np.testing.assert_array_equal((terms.T_c + terms.T_n)[:-1], run.torque[1:])
        np.testing.assert_allclose(terms.delta_theta, run.rate_error + 12.0 * run.error, rtol=0.0, atol=1e-14)


def make_terms(rng, **changes):
    """Random terms of four samples."""
    values = {
        "error_x": rng.normal(size=4),
        "delta_theta": rng.normal(size=4),
        "delta_x": rng.normal(size=4),
        "T_c": np.zeros(4),
        "T_n": np.zeros(4),
        "estimates_theta": np.tile(nominal_estimates(PLANT)[:5], (4, 1)),
        "estimates_x": np.tile(nominal_estimates(PLANT)[5:], (4, 1)),
        "eta": np.ones(4),
        "power": rng.normal(size=4),
    }
    return RecordedTerms(**{**values, **changes})


def test_lyapunov_function_is_constant_without_errors():
    rng = np.random.default_rng(0)
    zero = np.zeros(4)
    theta = rng.uniform(-1, 1, 4)
    np.testing.assert_allclose(lyapunov(make_terms(rng, delta_theta=zero, delta_x=zero), theta, PLANT), 1.5)
    # Eq. (2): the kinetic part is positive definite.
    assert (lyapunov(make_terms(rng), theta, PLANT) > 1.5).all()
    wrong = make_terms(rng, delta_theta=zero, delta_x=zero, estimates_x=np.tile([0.0414, 0.738, 0.01, 0.0414], (4, 1)))
    np.testing.assert_allclose(lyapunov(wrong, theta, PLANT), 1.5 + 0.5 * 0.1**2 / 0.1)


@pytest.mark.parametrize("norm", [True, False])
def test_derivative_is_what_the_law_makes_of_it(norm):
    # delta_theta T_n - w + eta^(-1/3) eta', with (39c) and (39d) written out once more.
    rng = np.random.default_rng(2)
    terms = make_terms(rng, eta=rng.uniform(0.5, 2.0, 4))
    d, dx, eta, w = terms.delta_theta, terms.delta_x, terms.eta, terms.power
    share = d / (d**2 + REGULARISED.beta)
    T_n = -np.sign(d) * np.abs(dx) * (eta + PUBLISHED.K2) - share * (
        (eta + 1) * PUBLISHED.K3 * dx**2 + (eta - 1) * np.abs(w)
    )
    eta_rate = eta ** (4 / 3) * d * share * (PUBLISHED.K3 * dx**2 + (np.abs(w) if norm else w))
    expected = -PUBLISHED.K1 * d**2 + d * T_n - w + eta ** (-1 / 3) * eta_rate
    np.testing.assert_allclose(derivative(terms, REGULARISED.beta, norm=norm), expected, rtol=1e-12)


def test_derivative_falls_for_positive_power_and_can_rise_for_negative():
    rng = np.random.default_rng(3)
    for norm in (True, False):
        assert (derivative(make_terms(rng, power=np.abs(rng.normal(size=4))), REGULARISED.beta, norm=norm) <= 0.0).all()
        small = make_terms(rng, delta_theta=np.full(4, 1e-3), delta_x=np.full(4, 1e-2), power=np.full(4, -0.1))
        assert (derivative(small, REGULARISED.beta, norm=norm) > 0.0).all()


def test_lyapunov_function_rises_off_the_nominal_plant_where_the_proof_fails():
    fall = descent(trace(adaptive(), M=0.45, mu=0.009), Capsule().plant(0.45, 0.009), regularised=True)
    assert fall.end - fall.start == pytest.approx(fall.rise - fall.fall, abs=1e-9)
    assert fall.rise > 0.1 and 0.05 < fall.rising < 0.5
    assert sum(fall.rise_by_cause.values()) == pytest.approx(1.0)
    assert next(share for name, share in fall.rise_by_cause.items() if name.endswith("< 0")) > 0.9


def test_traces_refuse_a_law_of_another_rate():
    with pytest.raises(ValueError, match=r"controller must run every 0.001 s, got dt=0.0005 s"):
        trace(adaptive(dt=5e-4))
