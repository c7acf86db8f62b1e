"""The adaptive law over ranges, open choices, rates and long runs, and why its Lyapunov function rises."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.laws.adaptive import adaptive, adaptive_as_published, nominal_estimates
from baselines.laws.gains import UNREGULARISED
from baselines.paper import adaptive as study
from baselines.paper.adaptive import LawTerms, law_terms, lyapunov, run_cycles, varied
from baselines.paper.tracking import simulate
from capsule_gym import Capsule
from capsule_gym.task import TORQUE_LIMIT

PLANT = Capsule().plant()
LIGHT, HEAVY = (0.45, 0.009), (0.55, 0.011)


@pytest.mark.parametrize("regularised", [True, False])
def test_recomputed_terms_are_those_of_the_law(regularised):
    controller = adaptive() if regularised else adaptive_as_published()
    for run in simulate(controller, [(0.5, 0.01), (0.45, 0.011)], cycles=2):
        terms = law_terms(run, regularised=regularised)
        # The same functions: no digit may differ.
        np.testing.assert_array_equal((terms.T_c + terms.T_n)[:-1], run.torque[1:])
        np.testing.assert_allclose(terms.delta_theta, run.rate_error + 12.0 * run.error, rtol=0.0, atol=1e-14)


def make_terms(rng, **changes):
    """Random terms of four samples."""
    values = {name: rng.normal(size=4) for name in LawTerms._fields}
    values |= {"eta": np.ones(4), "estimates": np.tile(nominal_estimates(PLANT), (4, 1))}
    return LawTerms(**{**values, **changes})


def test_lyapunov_function_by_hand():
    rng, zero = np.random.default_rng(0), np.zeros(4)
    theta = rng.uniform(-1, 1, 4)
    np.testing.assert_allclose(lyapunov(make_terms(rng, delta_theta=zero, delta_x=zero), theta, PLANT), 1.5)
    # Eq. (2): the kinetic part is positive definite.
    assert (lyapunov(make_terms(rng), theta, PLANT) > 1.5).all()
    wrong = np.tile(nominal_estimates(PLANT), (4, 1))
    wrong[:, 6] += 0.1
    found = lyapunov(make_terms(rng, delta_theta=zero, delta_x=zero, estimates=wrong), theta, PLANT)
    np.testing.assert_allclose(found, 1.5 + 0.5 * 0.1**2 / 0.1)


@pytest.mark.parametrize(
    "choices",
    [
        {"regularised": True},
        {"regularised": False, "beta": 3.0, "n": 2, "eta_0": 0.3},
    ],
    ids=["regularised", "unregularised, other choices"],
)
def test_varied_law_is_the_law_itself(choices):
    plants = [(0.5, 0.01), LIGHT]
    for own, other in zip(*(simulate(make(**choices), plants, cycles=2) for make in (adaptive, varied)), strict=True):
        np.testing.assert_array_equal(own.torque, other.torque)
        np.testing.assert_array_equal(own.x, other.x)
        assert np.ptp(own.theta) > 0.2


def test_errors_by_cycle_are_those_of_the_run():
    found = run_cycles(varied(regularised=True), [LIGHT, HEAVY], cycles=2)
    for i, run in enumerate(simulate(adaptive(), [LIGHT, HEAVY], cycles=2)):
        cycle = len(run.t) // 2
        for k, values in enumerate((run.error, run.rate_error, run.rate_error + 12.0 * run.error)):
            first, second = (np.abs(part).max() for part in (values[: cycle + 1], values[cycle + 1 :]))
            assert found.errors[:, k, i] == pytest.approx([first, second], rel=1e-9)
    assert not found.failed.any() and found.until == pytest.approx([13.2, 13.2])


def test_regularised_law_over_the_ranges(laws):
    law = laws[0]
    assert len(law.runs) == 9 and law.failures == 0
    assert law.worst("error_rms")["error_rms"] < 1e-4 and law.worst("peak_torque")["peak_torque"] < 1.31
    speeds = [law.worst("mean_speed", smallest=smallest)["mean_speed"] for smallest in (True, False)]
    assert speeds == pytest.approx([1.26, 1.53], abs=0.01)
    # V rises off the nominal plant, where the proof fails.
    assert len(law.lyapunov) == 5
    light = next(v for v in law.lyapunov if (v["M"], v["mu"]) == pytest.approx(LIGHT))
    assert light["end"] - light["start"] == pytest.approx(light["rise"] - light["fall"], abs=1e-9)
    assert light["rise"] > 0.1 and 0.05 < light["rising"] < 0.5


def test_unregularised_law_fails_on_most_of_the_ranges(laws):
    _, corrected, limited = laws
    # Which plants fail is chaotic at the edge; that nearly all do is not.
    assert corrected.failures >= 7 and limited.failures >= 3
    assert not corrected.runs[4]["failed"] and corrected.runs[4]["M"] == 0.5
    plants = [(run["M"], run["mu"]) for run in corrected.runs]
    # Both ways to run it agree, to the millisecond.
    for law, limit in ((corrected, corrected.torque_limit), (limited, TORQUE_LIMIT)):
        again = run_cycles(varied(regularised=False), plants, torque_limit=limit)
        assert again.failed.tolist() == [run["failed"] for run in law.runs]
        assert again.until == pytest.approx([run["until"] for run in law.runs], abs=2e-3)
    # eta only grows, and on some plant up to its bound.
    assert limited.worst("eta")["eta"] == pytest.approx(UNREGULARISED.eta_bound)


def test_no_choice_saves_the_plants_of_another_mass():
    off = np.array([M != 0.5 for M, _ in study.plant_grid()])
    for choices in ({"beta": 10.0, "eta_0": 0.1}, {"beta": 1e-4, "n": 3}):
        found = run_cycles(varied(regularised=False, **choices), study.plant_grid())
        assert found.failed[off].all() and off.sum() == 20


def test_error_on_the_nominal_plant_is_that_of_the_zero_order_hold():
    slow, fast = (
        run_cycles(varied(regularised=True, dt=dt), [(0.5, 0.01), LIGHT, HEAVY], cycles=1).errors[0]
        for dt in (1e-3, 2e-4)
    )
    # The rows are the errors of angle and rate, and delta_theta; the columns the plants.
    assert (slow / fast)[:, 0] == pytest.approx([5.0, 5.0, 5.0], rel=0.05)
    assert (slow / fast)[:, 1:] == pytest.approx(np.ones((3, 2)), rel=0.1)


def test_errors_fall_over_many_cycles_off_the_nominal_plant_and_do_not_vanish():
    errors = run_cycles(varied(regularised=True), [LIGHT, HEAVY], cycles=60).errors
    fall = errors[0] / errors[-1]
    assert (fall[0] > 5.0).all() and (fall[2] > 2.0).all() and (fall[2] < 5.0).all()
