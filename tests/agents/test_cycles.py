import dataclasses

import numpy as np
import pytest
from PIL import Image

from agents.cycles import __main__ as command
from agents.cycles.course import (
    BACKWARD,
    FORWARD,
    STICK,
    Course,
    balance,
    contact,
    find_cycle,
    follow,
    stretches,
)
from agents.cycles.picture import draw_cycles
from agents.evaluation.episodes import evaluate
from agents.evaluation.policies import Candidate, find_candidate
from baselines.drawing import save, style
from capsule_gym.evaluation_sets import NOMINAL_PLANT, EvaluationSet, PlantSpec
from tests.agents.fakes import Sine, make_policy

PLANT = PlantSpec(0.6, 0.05, seed=3)


@pytest.mark.parametrize(
    "policy",
    [
        make_policy(),
        Sine(0.5),
        Sine(0.5, env_kwargs={"control_dt": 0.01, "randomization": "wide", "num_envs": 3}),
        Sine(0.4, env_kwargs={"controller": "baselines:adaptive", "residual_limit": 1.0}),
    ],
    ids=["network", "torque", "fine", "residual"],
)
def test_a_course_is_the_motion_of_the_episode(policy):
    course = follow("name", policy, PLANT, seconds=2.0)
    (episode,) = evaluate(policy, EvaluationSet("one", (PLANT,)), horizon=2.0)
    assert course.x[-1] == pytest.approx(episode["distance"], abs=1e-12)
    assert course.t[-1] == pytest.approx(2.0)
    assert np.abs(course.torque).max() == pytest.approx(episode["peak_torque"])
    weight = (PLANT.M + 0.138) * 9.81
    assert course.normal_force[1:].min() / weight == pytest.approx(episode["smallest_normal_ratio"])
    assert not course.failed


def test_a_course_ends_with_its_episode():
    course = follow("wild", Sine(1.5, period=10.0), PLANT, seconds=2.0)
    assert course.failed and course.t[-1] < 1.0
    with pytest.raises(ValueError, match="must last for 20 s without failure, got wild until 0"):
        find_cycle(course)


def made(period, *, drift=1.0, sub=0.0, seconds=30.0):
    """A motion that is known: a sine of theta, every other swing larger by a share, and a platform that follows it."""
    t = np.arange(0.0, seconds, 1e-3)
    angle = 2.0 * np.pi * t / period
    theta = (1.0 + sub * np.cos(0.5 * angle)) * np.sin(angle)
    theta_dot = np.gradient(theta, t)
    x = 0.01 * theta + 0.01 * drift * t
    force = np.full_like(t, 6.0)
    return Course("made", t, theta, theta_dot, x, np.gradient(x, t), np.sign(theta_dot), force, 1.0, False)


def test_the_cycle_of_a_sine():
    cycle = find_cycle(made(0.8))
    assert cycle.swings == 1
    assert cycle.course.t[-1] == pytest.approx(0.8)
    assert cycle.course.theta[0] == pytest.approx(-1.0, abs=1e-5)
    assert cycle.mismatch < 0.01
    found = balance(cycle)
    assert found.speed == pytest.approx(1.0, rel=1e-2)
    assert cycle.window_speed == pytest.approx(1.0, rel=1e-2)
    assert found.swing == pytest.approx(2.0, abs=1e-4)
    assert found.saturated > 0.99


def test_swings_that_differ_by_turns_make_a_cycle_of_two():
    cycle = find_cycle(made(0.8, sub=0.2))
    assert cycle.swings == 2
    assert cycle.course.t[-1] == pytest.approx(1.6)


def test_what_does_not_swing_has_no_cycle():
    still = follow("zero", Sine(0.0), NOMINAL_PLANT, seconds=21.0)
    with pytest.raises(ValueError, match="must swing at least twice in its last 20 s, got zero"):
        find_cycle(still)
    with pytest.raises(ValueError, match="must hold two cycles"):
        find_cycle(made(9.0))


def test_the_balance_of_a_steady_cycle_closes():
    cycle = find_cycle(follow("adaptive", find_candidate("adaptive").policies[0]))
    assert (cycle.swings, cycle.course.t[-1]) == (1, pytest.approx(6.6))
    found = balance(cycle)
    assert sum(phase.time for phase in found.phases.values()) == pytest.approx(1.0)
    assert sum(phase.travel for phase in found.phases.values()) == pytest.approx(cycle.course.x[-1])
    assert found.phases[FORWARD].travel > 0.0 == found.phases[STICK].travel > found.phases[BACKWARD].travel
    # Friction opposes the slip, with the coefficient times the normal force, and what it gives and takes cancels.
    assert abs(sum(phase.impulse for phase in found.phases.values())) < 1e-3 * abs(found.phases[FORWARD].impulse)
    weight = (0.5 + 0.138) * 9.81
    for phase, sign in ((FORWARD, -1.0), (BACKWARD, 1.0)):
        own = found.phases[phase]
        expected = sign * 0.01 * own.press * weight * own.time * found.period
        assert own.impulse == pytest.approx(expected, rel=0.02)
    # Friction brakes the stroke by so much, and the profile brings everything to rest before the next.
    assert found.glide[0] == pytest.approx(100.0 * found.phases[FORWARD].impulse / 0.638, abs=0.1)
    assert cycle.course.x_dot[0] == 0.0 == cycle.course.x_dot[-1]
    # Over a cycle the floor carries the weight.
    assert sum(each.time * each.press for each in found.phases.values()) == pytest.approx(1.0, abs=2e-3)
    # And in stick nothing moves.
    stuck = contact(cycle.course) == STICK
    assert (cycle.course.x_dot[1:][stuck] == 0.0).mean() > 0.99


def test_phases_that_are_absent_have_no_press():
    course = dataclasses.replace(made(0.8), x=np.arange(30_000) * 1e-5)
    found = balance(find_cycle(course))
    assert np.isnan(found.phases[STICK].press) and np.isnan(found.phases[BACKWARD].press_over_way)
    assert found.phases[FORWARD].press == pytest.approx(found.phases[FORWARD].press_over_way)


def test_stretches():
    assert stretches(np.array([1, 1, 0, -1, -1])) == [(1, 0, 2), (0, 2, 3), (-1, 3, 5)]


@pytest.mark.parametrize("count", [1, 6])
def test_figure(count, tmp_path):
    cycles = [find_cycle(made(0.5 + 0.1 * n)) for n in range(count)]
    with style():
        save(draw_cycles(cycles), tmp_path / "cycles")
    with Image.open(tmp_path / "cycles.png") as picture:
        assert picture.width == 1400


def test_the_seed_with_the_median_speed_is_shown(monkeypatch):
    speeds = {0: 3.0, 4: 1.0, 7: 2.0, 9: 4.0}

    def course(name, policy):
        return dataclasses.replace(made(0.8), x=np.array([0.0, speeds[policy.training_seed]]), name=name)

    monkeypatch.setattr(command, "follow", course)
    runs = tuple(make_policy(seed) for seed in speeds)
    assert command.median_course(Candidate("learnt", runs, "")).name == "learnt (seed 7)"
    assert command.median_course(Candidate("learnt", runs[:1], "")).name == "learnt"


def test_the_best_of_the_results_are_shown_by_default():
    names = command.default_names()
    assert names[0] == "adaptive" and len(names) == 5
    assert len(set(names)) == 5
    # Copies of the optimum, which is shown itself.
    assert not any(name.startswith("optimum-distilled") for name in names)


def test_command_line(tmp_path, capsys):
    words = ["adaptive", "gait-nominal", "--markdown", str(tmp_path / "t.md"), "--figure", str(tmp_path / "f.png")]
    assert command.main(words) == 0
    out = capsys.readouterr().out
    assert "adaptive" in out and "gait-nominal" in out
    text = (tmp_path / "t.md").read_text()
    assert "[start:shapes]" in text and "[end:phases]" in text
    assert (tmp_path / "f.png").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["zero"] * 7, "names must be at most 6, got 7"),
        (["nobody"], "got 'nobody'"),
        (["zero"], "must swing at least twice"),
        (["zero", "--figure", "cycles.pdf"], "--figure must name a PNG, got 'cycles.pdf'"),
        (["zero", "--markdown", "/nowhere/t.md"], "--markdown must name a file in a folder that exists"),
        (["somewhere:policy"], "--trust accepts that"),
    ],
)
def test_wrong_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(words)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
