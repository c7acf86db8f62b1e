import dataclasses

import numpy as np
import pytest

from agents.analysis import __main__ as command
from agents.analysis import limit_cycle
from agents.analysis.limit_cycle import (
    Trajectory,
    default_policies,
    draw,
    find_cycle,
    median_run,
    simulate,
    summarize,
    table,
)
from agents.evaluation.episodes import evaluate
from agents.evaluation.policies import Candidate, find_candidate
from capsule_gym.evaluation_sets import NOMINAL_PLANT, EvaluationSet, PlantSpec
from tests.agents.fakes import Sine, make_policy

PLANT = PlantSpec(0.6, 0.05, seed=3)


@pytest.mark.parametrize(
    "policy",
    [
        Sine(0.5, env_kwargs={"control_dt": 0.01, "randomization": "wide", "num_envs": 3}),
        Sine(0.4, env_kwargs={"controller": "baselines:adaptive", "residual_limit": 1.0}),
    ],
    ids=["torque", "residual"],
)
def test_a_trajectory_is_the_motion_of_the_episode(policy):
    trajectory = simulate("name", policy, PLANT, seconds=2.0)
    (episode,) = evaluate(policy, EvaluationSet("one", (PLANT,)), horizon=2.0)
    assert trajectory.x[-1] == pytest.approx(episode["distance"], abs=1e-12)
    assert trajectory.t[-1] == pytest.approx(2.0)
    assert np.abs(trajectory.torque).max() == pytest.approx(episode["peak_torque"])
    weight = (PLANT.M + 0.138) * 9.81
    assert trajectory.normal_force[1:].min() / weight == pytest.approx(episode["smallest_normal_ratio"])
    assert not trajectory.failed


def test_a_trajectory_ends_with_its_episode():
    trajectory = simulate("wild", Sine(1.5, period=10.0), PLANT, seconds=2.0)
    assert trajectory.failed and trajectory.t[-1] < 1.0
    with pytest.raises(ValueError, match="must last for 20 s without failure, got wild until 0"):
        find_cycle(trajectory)


def made(period, *, drift=1.0, sub=0.0, seconds=30.0):
    """A motion that is known: a sine of theta, every other swing larger by a share, and a platform that follows it."""
    t = np.arange(0.0, seconds, 1e-3)
    angle = 2.0 * np.pi * t / period
    theta = (1.0 + sub * np.cos(0.5 * angle)) * np.sin(angle)
    theta_dot = np.gradient(theta, t)
    x = 0.01 * theta + 0.01 * drift * t
    force = np.full_like(t, 6.0)
    return Trajectory("made", t, theta, theta_dot, x, np.gradient(x, t), np.sign(theta_dot), force, 1.0, False)


def test_the_cycle_of_a_sine():
    cycle = find_cycle(made(0.8))
    assert cycle.swings == 1
    assert cycle.trajectory.t[-1] == pytest.approx(0.8)
    assert cycle.trajectory.theta[0] == pytest.approx(-1.0, abs=1e-5)
    assert cycle.mismatch < 0.01
    found = summarize(cycle.trajectory)
    assert found.speed == pytest.approx(1.0, rel=1e-2)
    assert cycle.window_speed == pytest.approx(1.0, rel=1e-2)
    assert found.saturated > 0.99


def test_swings_that_differ_by_turns_make_a_cycle_of_two():
    cycle = find_cycle(made(0.8, sub=0.2))
    assert cycle.swings == 2
    assert cycle.trajectory.t[-1] == pytest.approx(1.6)


def test_what_does_not_swing_has_no_cycle():
    still = simulate("zero", Sine(0.0), NOMINAL_PLANT, seconds=21.0)
    with pytest.raises(ValueError, match="must swing at least twice in its last 20 s, got zero"):
        find_cycle(still)
    with pytest.raises(ValueError, match="must hold two cycles"):
        find_cycle(made(9.0))


def test_the_papers_law_brings_everything_to_rest_in_every_cycle():
    cycle = find_cycle(simulate("adaptive", find_candidate("adaptive").policies[0]))
    assert (cycle.swings, cycle.trajectory.t[-1]) == (1, pytest.approx(6.6))
    assert cycle.trajectory.x_dot[0] == 0.0 == cycle.trajectory.x_dot[-1]
    low, high = summarize(cycle.trajectory).centre
    assert low < 0.0 < high


def test_the_table_and_the_figure():
    cycles = [find_cycle(made(0.5 + 0.1 * n)) for n in range(3)]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table(cycles).splitlines()]
    assert [row[1] for row in rows[2:]] == ["0.50", "0.60", "0.70"]
    assert [row[4] for row in rows[2:]] == ["x 1.00", "x 0.83", "x 0.71"]
    assert len(draw(cycles).axes) == 15


def test_the_seed_with_the_median_speed_is_shown(monkeypatch):
    speeds = {0: 3.0, 4: 1.0, 7: 2.0, 9: 4.0}

    def trajectory(name, policy):
        return dataclasses.replace(made(0.8), x=np.array([0.0, speeds[policy.training_seed]]), name=name)

    monkeypatch.setattr(limit_cycle, "simulate", trajectory)
    policies = tuple(make_policy(seed) for seed in speeds)
    assert median_run(Candidate("learnt", policies, "")).name == "learnt (seed 7)"
    assert median_run(Candidate("learnt", policies[:1], "")).name == "learnt"


def test_the_best_of_the_results_are_shown_by_default():
    names = default_policies()
    assert names[0] == "adaptive" and len(set(names)) == len(names) == 5
    # Networks that imitate the optimum, which is shown itself.
    assert not any(name.startswith("optimum-distilled") for name in names)


def test_a_policy_without_a_cycle_is_named_by_the_command(capsys):
    with pytest.raises(SystemExit):
        command.main(["limit_cycle", "--policies", "zero"])
    assert "must swing at least twice" in capsys.readouterr().err
