"""The adaptive law over ranges, open choices, rates and long runs, and its Lyapunov function."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.paper import adaptive as study
from baselines.paper.adaptive import lyapunov, run_cycles, sliding
from baselines.paper.tracking import simulate
from capsule_gym import Capsule
from capsule_gym.control.laws.adaptive import adaptive
from capsule_gym.control.laws.gains import UNREGULARISED
from capsule_gym.tasks.task import TORQUE_LIMIT

PLANT = Capsule().plant()
NOMINAL = (0.5, 0.01)
LIGHT = (0.45, 0.009)
HEAVY = (0.55, 0.011)
START = adaptive().memory
# V without errors: the term of eta = 1.
LEAST = 1.5


@pytest.fixture(scope="module")
def exact():
    """A cycle that follows the reference without errors."""
    (run,) = simulate(adaptive(), cycles=1)
    theta, theta_dot, _, x_d, x_d_dot, *_ = run.reference.T
    memory = np.tile(START, (len(run.t), 1))
    return replace(run, theta=theta, theta_dot=theta_dot, x=x_d, x_dot=x_d_dot, memory=memory)


def test_lyapunov_function_without_errors_is_the_term_of_eta(exact):
    np.testing.assert_allclose(lyapunov(exact, START, PLANT), LEAST, rtol=1e-12)


# An entry of alpha_theta, one of alpha_x.
@pytest.mark.parametrize("parameter", ["k", "mu"])
def test_lyapunov_function_of_a_wrong_estimate(exact, parameter):
    off = Capsule(**{parameter: getattr(PLANT, parameter) + 0.1}).plant()
    expected = LEAST + 0.5 * 0.1**2 / 0.1
    np.testing.assert_allclose(lyapunov(exact, START, off), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("rate", "error", "inertia"),
    [("theta_dot", 0.2, 0.138 * 0.3**2), ("x_dot", 0.1, 0.5 + 0.138)],
)
def test_lyapunov_function_of_a_rate_error(exact, rate, error, inertia):
    # The other sliding variable is 0.
    wrong = getattr(exact, rate) + error
    late = replace(exact, **{rate: wrong})
    expected = LEAST + 0.5 * inertia * error**2
    np.testing.assert_allclose(lyapunov(late, START, PLANT), expected, rtol=1e-9)


def test_lyapunov_function_contains_the_kinetic_energy_of_the_sliding_variables(exact):
    noise = np.random.default_rng(0).normal(size=(2, len(exact.t)))
    noisy = replace(exact, theta_dot=exact.theta_dot + noise[0], x_dot=exact.x_dot + noise[1])
    coupling = -0.138 * 0.3 * np.cos(exact.theta)
    inertia = np.full((len(exact.t), 2, 2), [[0.138 * 0.3**2, 0.0], [0.0, 0.5 + 0.138]])
    inertia[:, 0, 1] = inertia[:, 1, 0] = coupling  # Eq. (2)
    energy = 0.5 * np.einsum("in,nij,jn->n", noise, inertia, noise)
    np.testing.assert_allclose(lyapunov(noisy, START, PLANT), LEAST + energy, rtol=1e-9)


def test_lyapunov_function_of_another_eta(exact):
    # The memory holds the third root of eta. With n = 1 the term is 3 / 2 eta^(2 / 3).
    *estimates, _, anchor = START
    start = (*estimates, 2.0, anchor)
    other = replace(exact, memory=np.tile(start, (len(exact.t), 1)))
    np.testing.assert_allclose(lyapunov(other, start, PLANT), 1.5 * 4.0, rtol=1e-12)


@pytest.mark.parametrize("regularised", [True, False])
def test_errors_by_cycle_are_those_of_the_run(regularised):
    controller = adaptive(regularised=regularised)
    plants = [NOMINAL, LIGHT, HEAVY]
    failed, errors = run_cycles(controller, plants, cycles=2, shown=(1, 2))
    runs = simulate(controller, plants, cycles=2)
    assert failed.tolist() == [not run.completed for run in runs]
    assert failed.any() == (not regularised)
    for i in np.flatnonzero(~failed):
        run = runs[i]
        cycle = len(run.t) // 2
        delta_theta, _ = sliding(run)
        values = np.abs([run.error, run.rate_error, delta_theta])
        first = values[:, : cycle + 1].max(axis=1)
        second = values[:, cycle + 1 :].max(axis=1)
        assert errors[..., i] == pytest.approx(np.array([first, second]), rel=1e-9)


def test_regularised_law_tracks_over_the_ranges(laws):
    law, *_ = laws
    assert len(law.runs) == 9
    assert law.failures == 0
    assert law.worst("error_rms")["error_rms"] < 1e-4
    assert law.worst("peak_torque")["peak_torque"] < 1.31
    # The reference reaches 7.8 rad/s.
    assert law.worst("peak_velocity")["peak_velocity"] == pytest.approx(7.8, abs=0.01)


def test_speeds_of_the_regularised_law(laws):
    law, *_ = laws
    assert law.worst("mean_speed", smallest=True)["mean_speed"] == pytest.approx(1.26, abs=0.01)
    assert law.worst("mean_speed")["mean_speed"] == pytest.approx(1.53, abs=0.01)


def test_lyapunov_function_rises_on_the_lightest_plant(laws):
    # The proof fails on plants other than the nominal one.
    law, *_ = laws
    steepest = law.worst("rise")
    assert (steepest["M"], steepest["mu"]) == pytest.approx(LIGHT)
    assert steepest["rise"] > 0.1
    assert 0.05 < steepest["rising"] < 0.5


def test_unregularised_law_fails_on_most_of_the_ranges(laws):
    _, corrected, limited = laws
    # At the edge, small perturbations change which plants fail, but nearly all plants fail.
    assert corrected.failures >= 7
    assert limited.failures >= 3


def test_only_the_limited_motor_has_a_limit(laws):
    *unlimited, limited = laws
    assert limited.worst("peak_torque")["peak_torque"] == TORQUE_LIMIT
    # At the edge of loss of contact the unregularised law asks for much more.
    assert unlimited[1].worst("peak_torque")["peak_torque"] > 2.0 * TORQUE_LIMIT


def test_studies_are_named_by_their_form(laws):
    names = [study.REGULARISED_LAW, study.CORRECTED_LAW, study.CORRECTED_LAW]
    assert [law.law for law in laws] == names


def test_unregularised_law_does_not_fail_on_the_nominal_plant(laws):
    _, corrected, _ = laws
    nominal = corrected.runs[4]
    assert nominal["M"] == 0.5
    assert not nominal["failed"]


def test_eta_reaches_its_bound(laws):
    # It never decreases.
    *_, limited = laws
    assert limited.worst("eta")["eta"] == pytest.approx(UNREGULARISED.eta_bound)


@pytest.mark.parametrize("choices", [{"beta": 10.0, "eta_0": 0.1}, {"beta": 1e-4, "n": 3}])
def test_unregularised_law_fails_whatever_the_choices(choices):
    plants = study.plant_grid()
    off = np.array([M != 0.5 for M, _ in plants])
    assert off.sum() == 20
    failed, _ = run_cycles(adaptive(regularised=False, **choices), plants)
    assert failed[off].all()


@pytest.fixture
def variants(monkeypatch):
    """The number of failures by choices: of three plants one fails at 10 kHz, one with the law's
    own choices."""

    def run(controller, plants):
        assert plants == study.plant_grid()
        plain = adaptive(regularised=False)
        own = (controller.law, controller.memory) == (plain.law, plain.memory)
        return np.array([controller.dt == 1e-4, own, False]), None

    monkeypatch.setattr(study, "run_cycles", run)
    return {tuple(choices): failures for *choices, failures in study.study_variants()}


# beta, eta, exponent and rate of the law itself.
OWN = (UNREGULARISED.beta, UNREGULARISED.eta_0, UNREGULARISED.n, 1000)


def test_the_first_variant_is_the_law_itself(variants):
    assert next(iter(variants)) == OWN


def test_variants_change_one_choice_at_a_time(variants):
    for n, values in enumerate((study.BETAS, study.ETAS, study.EXPONENTS, study.RATES)):
        # The other three choices are those of the law itself.
        alike = [each for each in variants if (*each[:n], OWN[n], *each[n + 1 :]) == OWN]
        assert {each[n] for each in alike} == set(values)


def test_variants_contain_the_corners(variants):
    assert (study.BETAS[0], study.ETAS[-1], study.EXPONENTS[-1], 1000) in variants


def test_variants_at_the_highest_rate_have_the_own_exponent(variants):
    assert {n for *_, n, rate in variants if rate == 10_000} == {UNREGULARISED.n}


def test_failures_of_variants_are_counted(variants):
    failing = {choices for choices, failures in variants.items() if failures}
    assert failing == {OWN, *(choices for choices in variants if choices[3] == 10_000)}


def test_errors_are_proportional_to_the_period_of_the_law_on_the_nominal_plant():
    # On others, the errors are those of the estimates.
    errors = []
    for dt in (1e-3, 2e-4):
        _, shown = run_cycles(adaptive(dt=dt), [NOMINAL, LIGHT], cycles=1, shown=(1,))
        errors.append(shown[0])
    slow, fast = errors
    # The rows are the errors of angle and rate, and delta_theta; the columns are the plants.
    assert slow / fast == pytest.approx(np.array([[5.0, 1.0]] * 3), rel=0.1)


def test_errors_fall_off_the_nominal_plant():
    _, errors = run_cycles(adaptive(), [LIGHT, HEAVY], cycles=60, shown=(1, 60))
    angle, _, delta_theta = errors[0] / errors[-1]
    assert (angle > 5.0).all()
    assert (delta_theta > 2.0).all()
    assert (delta_theta < 5.0).all()
