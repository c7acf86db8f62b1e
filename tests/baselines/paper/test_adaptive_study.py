"""The adaptive law over ranges, open choices, rates and long runs: that the study runs the law, and what it finds."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.laws.adaptive import adaptive
from baselines.laws.gains import UNREGULARISED
from baselines.paper import adaptive_study as study
from baselines.paper.adaptive_study import LongRun
from baselines.paper.adaptive_variants import endure, varied
from baselines.paper.adaptive_verdicts import converged
from baselines.paper.traces import trace
from capsule_gym.layout import Row
from capsule_gym.parameters import RANDOMIZATIONS, EnvConfig
from capsule_gym.simulation import Simulation
from capsule_gym.task import TORQUE_LIMIT

LIGHT, HEAVY = (0.45, 0.009), (0.55, 0.011)


@pytest.mark.parametrize(
    "choices",
    [
        {"regularised": True},
        {"regularised": False},
        {"regularised": False, "beta": 3.0, "n": 2, "eta_0": 0.3, "dt": 5e-4},
    ],
    ids=["regularised", "unregularised", "other choices and rate"],
)
def test_law_of_the_study_is_the_law_itself(choices):
    courses = []
    for make in (adaptive, varied):
        options = EnvConfig(controller=make(**choices), residual_limit=0.0, physics_dt=choices.get("dt", 1e-3))
        simulation = Simulation(6, options)
        for i in range(6):
            simulation.seed(i, i)
        simulation.reset(np.arange(6))
        running, course = np.ones(6, np.bool_), []
        for _ in range(360):
            simulation.step(np.zeros(6), running)
            course.append(simulation.rows(0, Row.energy))
            running &= simulation.row(Row.termination) == 0.0
        courses.append(np.array(course))
    np.testing.assert_array_equal(*courses)
    assert np.ptp(courses[0][:, Row.theta]) > 1.0


def test_peaks_are_those_of_the_run():
    found = endure(varied(regularised=True), [LIGHT, HEAVY], cycles=2)
    for i, (M, mu) in enumerate((LIGHT, HEAVY)):
        run = trace(adaptive(), M=M, mu=mu, cycles=2)
        cycle = len(run.t) // 2
        sliding = run.rate_error + 12.0 * run.error
        for k, values in enumerate((run.error, run.rate_error, sliding)):
            first, second = (np.abs(part).max() for part in (values[: cycle + 1], values[cycle + 1 :]))
            assert found.peaks[:, k, i] == pytest.approx([first, second], rel=1e-9)
    assert found.failures == 0 and found.until == pytest.approx([13.2, 13.2])


def test_adaptive_law_over_the_ranges():
    regularised, inside = study.study_law(regularised=True)
    assert len(regularised.runs) == 25 and regularised.failures == 0
    assert regularised.worst("error_rms").error_rms < 1e-4
    assert regularised.worst("peak_torque").peak_torque < 1.31
    assert regularised.worst("mean_speed").mean_speed == pytest.approx(1.53, abs=0.01)
    assert regularised.worst("mean_speed", smallest=True).mean_speed == pytest.approx(1.26, abs=0.01)
    # The nominal plant and the corners of the ranges that the environment draws from.
    ranges = RANDOMIZATIONS["paper"]
    found = {(round(a.M, 9), round(a.mu, 9)) for a in inside}
    assert found == {(0.5, 0.01), *((M, mu) for M in ranges.M for mu in ranges.mu)}


def test_unregularised_law_fails_on_most_of_the_ranges():
    corrected, _ = study.study_law(regularised=False)
    limited, _ = study.study_law(regularised=False, torque_limit=TORQUE_LIMIT)
    # Which plants fail is chaotic at the edge; that nearly all do is not.
    assert corrected.failures >= 20
    assert limited.failures >= 10
    nominal = corrected.runs[12]
    assert (nominal.M, nominal.mu) == pytest.approx((0.5, 0.01)) and not nominal.ending
    # The other way to run it finds the same, to the millisecond.
    for law, limit in ((corrected, corrected.torque_limit), (limited, TORQUE_LIMIT)):
        again = endure(varied(regularised=False), study.plant_grid(), torque_limit=limit)
        assert again.failed.tolist() == [bool(run.ending) for run in law.runs]
        assert again.until == pytest.approx([run.until for run in law.runs], abs=2e-3)
    # eta only grows, and on some plant up to its bound.
    assert limited.worst("eta").eta == pytest.approx(UNREGULARISED.eta_bound)


def test_no_choice_saves_the_plants_of_another_mass():
    for choices in ({"beta": 10.0, "eta_0": 0.1}, {"beta": 1e-4, "n": 3}, {"beta": 10.0, "dt": 2e-4}):
        found = endure(varied(regularised=False, **choices), study.plant_grid())
        off = np.array([M != 0.5 for M, _ in study.plant_grid()])
        assert found.failed[off].all() and off.sum() == 20


def test_settings_vary_one_at_a_time_and_at_the_corners():
    settings = study.variant_settings()
    own = (0.01, 1.0, 1, 1000)
    assert settings[0] == own and len(set(settings)) == len(settings)
    for i, values in enumerate((study.BETAS, study.ETAS, study.EXPONENTS, study.RATES)):
        alone = {setting[i] for setting in settings if (*setting[:i], *setting[i + 1 :]) == (*own[:i], *own[i + 1 :])}
        assert alone == {*values, own[i]}
    assert {(beta, eta_0) for beta, eta_0, _, rate in settings if rate == 10_000} >= {
        (beta, eta_0) for beta in (1e-4, 10.0) for eta_0 in (0.1, 1.0)
    }


def test_every_deviation_of_the_mass_fails_sooner_or_later():
    until = {(d.parameter, d.percent): d.until for d in study.study_deviations()}
    for sign in (-1.0, 1.0):
        times = [until["M", sign * percent] for percent in study.DEVIATIONS if percent <= 2.0]
        assert None not in times and times == sorted(times, reverse=True)
        # It drifts by the same in every cycle: half the deviation takes about twice as long.
        assert times[2] / times[4] > 2.0
        assert until["M", sign * 5.0] < 1.0 and until["mu", sign * 5.0] < 33.0
        assert (until["M", sign * 0.2] or 396.0) > 33.0 and (until["mu", sign * 2.0] or 396.0) > 33.0


def test_what_remains_on_the_nominal_plant_is_the_torques_hold_and_off_it_is_not():
    plants = [(0.5, 0.01), LIGHT, HEAVY]
    slow, fast = (endure(varied(regularised=True, dt=dt), plants, cycles=1).peaks[0] for dt in (1e-3, 2e-4))
    # The rows are the errors of angle and rate, and delta_theta; the columns the plants.
    ratio = slow / fast
    assert ratio[:, 0] == pytest.approx([5.0, 5.0, 5.0], rel=0.05)
    assert ratio[:, 1:] == pytest.approx(np.ones((3, 2)), rel=0.1)


def test_errors_fall_over_many_cycles_off_the_nominal_plant():
    peaks = endure(varied(regularised=True), [LIGHT, HEAVY], cycles=60).peaks
    fall = peaks[0] / peaks[-1]
    assert (fall[0] > 5.0).all()
    assert (fall[2] > 2.0).all() and (fall[2] < 5.0).all()


def test_convergence_asks_for_a_tenth_on_every_plant():
    def run(*values):
        return LongRun(0.45, 0.009, 1000, (1, 60), values, values, values)

    assert converged([run(1.0, 0.1), run(2.0, 0.05)], "sliding")
    assert not converged([run(1.0, 0.1), run(2.0, 0.21)], "sliding")
