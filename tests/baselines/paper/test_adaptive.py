"""The adaptive law over ranges, open choices, rates and long runs, and the rise of its Lyapunov
function."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.paper import adaptive as study
from baselines.paper.adaptive import lyapunov, run_cycles, sliding
from baselines.paper.tracking import simulate
from capsule_gym import Capsule
from capsule_gym.control.laws.adaptive import adaptive
from capsule_gym.control.laws.gains import UNREGULARISED

PLANT = Capsule().plant()
LIGHT, HEAVY = (0.45, 0.009), (0.55, 0.011)


def test_lyapunov_function_by_hand():
    controller, mu = adaptive(), PLANT.mu
    (run,) = simulate(controller, cycles=1)
    theta, theta_dot, _, x_d, x_d_dot = run.reference.T[:5]
    memory = np.tile(controller.memory, (len(run.t), 1))
    exact = replace(run, theta=theta, theta_dot=theta_dot, x=x_d, x_dot=x_d_dot, memory=memory)
    # Without errors, only the term of eta = 1 is left.
    np.testing.assert_allclose(lyapunov(exact, controller.memory, PLANT), 1.5, rtol=1e-12)
    off = Capsule(mu=mu + 0.1).plant()
    np.testing.assert_allclose(
        lyapunov(exact, controller.memory, off), 1.5 + 0.5 * 0.1**2 / 0.1, rtol=1e-12
    )
    # delta_theta = 0.2 rad/s at delta_x = 0.
    late = lyapunov(replace(exact, theta_dot=theta_dot + 0.2), controller.memory, PLANT)
    np.testing.assert_allclose(late, 1.5 + 0.5 * 0.138 * 0.09 * 0.2**2, rtol=1e-9)
    # Eq. (2): the kinetic part is positive definite.
    rng = np.random.default_rng(0)
    noisy = {
        name: getattr(exact, name) + rng.normal(size=len(run.t))
        for name in ("theta_dot", "x", "x_dot")
    }
    assert (lyapunov(replace(exact, **noisy), controller.memory, PLANT) > 1.5).all()


@pytest.mark.parametrize("regularised", [True, False])
def test_errors_by_cycle_are_those_of_the_run(regularised):
    controller, plants = adaptive(regularised=regularised), [(0.5, 0.01), LIGHT, HEAVY]
    failed, errors = run_cycles(controller, plants, cycles=2, shown=(1, 2))
    for i, run in enumerate(simulate(controller, plants, cycles=2)):
        assert failed[i] == (not run.completed)
        if failed[i]:
            continue
        cycle = len(run.t) // 2
        for k, values in enumerate((run.error, run.rate_error, sliding(run)[0])):
            first, second = (
                np.abs(part).max() for part in (values[: cycle + 1], values[cycle + 1 :])
            )
            assert errors[:, k, i] == pytest.approx([first, second], rel=1e-9)
    assert failed.any() == (not regularised)


def test_regularised_law_over_the_ranges(laws):
    law = laws[0]
    assert len(law.runs) == 9 and law.failures == 0
    assert (
        law.worst("error_rms")["error_rms"] < 1e-4
        and law.worst("peak_torque")["peak_torque"] < 1.31
    )
    speeds = [
        law.worst("mean_speed", smallest=smallest)["mean_speed"] for smallest in (True, False)
    ]
    assert speeds == pytest.approx([1.26, 1.53], abs=0.01)
    # V rises on plants other than the nominal one, where the proof fails.
    light = law.worst("rise")
    assert (
        (light["M"], light["mu"]) == pytest.approx(LIGHT)
        and light["rise"] > 0.1
        and 0.05 < light["rising"] < 0.5
    )


def test_unregularised_law_fails_on_most_of_the_ranges_whatever_the_choices(laws):
    _, corrected, limited = laws
    # At the edge, small perturbations change which plants fail, but nearly all plants fail.
    assert corrected.failures >= 7 and limited.failures >= 3
    assert not corrected.runs[4]["failed"] and corrected.runs[4]["M"] == 0.5
    # eta never decreases, and on some plant it reaches its bound.
    assert limited.worst("eta")["eta"] == pytest.approx(UNREGULARISED.eta_bound)
    off = np.array([M != 0.5 for M, _ in study.plant_grid()])
    for choices in ({"beta": 10.0, "eta_0": 0.1}, {"beta": 1e-4, "n": 3}):
        failed, _ = run_cycles(adaptive(regularised=False, **choices), study.plant_grid())
        assert failed[off].all() and off.sum() == 20


def test_variants_change_one_choice_at_a_time_or_are_corners(monkeypatch):
    def run(controller, plants):
        assert plants == study.plant_grid()
        plain = adaptive(regularised=False)
        own = (controller.law, controller.memory) == (plain.law, plain.memory)
        return np.array([controller.dt == 1e-4, own, False]), None

    monkeypatch.setattr(study, "run_cycles", run)
    found = {tuple(variant): failed for *variant, failed in study.study_variants()}
    own = next(iter(found))
    assert own == (UNREGULARISED.beta, UNREGULARISED.eta_0, UNREGULARISED.n, 1000)
    for n, values in enumerate((study.BETAS, study.ETAS, study.EXPONENTS, study.RATES)):
        assert {
            each[n] for each in found if each[:n] + each[n + 1 :] == own[:n] + own[n + 1 :]
        } == set(values)
    assert (study.BETAS[0], study.ETAS[-1], study.EXPONENTS[-1], 1000) in found
    assert {n for *_, n, rate in found if rate == 10_000} == {own[2]}
    assert {each for each, failed in found.items() if failed} == {
        own,
        *(each for each in found if each[3] == 10_000),
    }


def test_errors_are_those_of_the_zero_order_hold_and_fall_off_the_nominal_plant():
    slow, fast = (
        run_cycles(adaptive(dt=dt), [(0.5, 0.01), LIGHT], cycles=1, shown=(1,))[1][0]
        for dt in (1e-3, 2e-4)
    )
    # The rows are the errors of angle and rate, and delta_theta; the columns are the plants.
    assert slow / fast == pytest.approx(np.array([[5.0, 1.0]] * 3), rel=0.1)
    errors = run_cycles(adaptive(), [LIGHT, HEAVY], cycles=60, shown=(1, 60))[1]
    fall = errors[0] / errors[-1]
    assert (fall[0] > 5.0).all() and (fall[2] > 2.0).all() and (fall[2] < 5.0).all()
