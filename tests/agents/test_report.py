import json
from dataclasses import replace

import numpy as np
import pytest

from agents import report
from agents.leaderboard.rows import load_row
from agents.training.presets import TRAINED_ROWS
from baselines.drawing import BLUE, MUTED
from capsule_gym.evaluation.episodes import evaluate
from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec, load_set
from tests import ROOT
from tests.agents.fakes import Sine, write_run
from tests.agents.training.small import small
from tests.figures import assert_lines, texts

PLANT = PlantSpec(0.6, 0.05, seed=3)
GOAL = {"env_kwargs": {"task": "goal"}, "mean": np.zeros(8), "variance": np.ones(8)}
GOAL["layers"] = ((np.zeros((1, 8), np.float32), np.zeros(1, np.float32)),)
COMPARED = [("CapsuleStickSlip-v0", {}, {"M": 0.5, "mu": 0.01}, "cost of transport")]
COMPARED += [("CapsuleGoal-v0", GOAL, {"M": 0.5, "mu": 0.2, "goal": 0.1}, "share of goals reached")]


@pytest.mark.parametrize(("env", "options", "plant", "shown"), COMPARED)
def test_a_finished_run_is_compared(tmp_path, monkeypatch, capsys, env, options, plant, shown):
    folder, set_file = tmp_path / "run", tmp_path / "two.json"
    write_run(folder, 3, **options)
    content = {
        "task": "direct",
        "algo": "ppo",
        "hyperparameters": {**small("direct", "ppo").to_dict(), "env": env},
    }
    (folder / "config.json").write_text(json.dumps(content))
    task = options.get("env_kwargs", {}).get("task", "speed")
    plants = [{**plant, "seed": n} for n in range(2)]
    set_file.write_text(json.dumps({"name": "two", "task": task, "plants": plants}))
    monkeypatch.setattr(report, "compare_to_row", lambda *_: "the published row")
    report.compare(folder, str(set_file))
    out = capsys.readouterr().out
    words = (
        "mean speed",
        "peak torque",
        "failures",
        "difference",
        "the published row\n",
        "comparison.png",
        shown,
    )
    assert all(word in out for word in words)


@pytest.mark.parametrize(
    ("changes", "theta", "speeds", "failed", "reason"),
    [
        ({}, 0.0, (1.0, 2.0), 0.0, None),
        ({"gamma": 0.9}, 0.6, (1.0, 2.0), 1.0, "other settings than the row, gamma 0.9"),
        ({}, 0.6, (1.0, 2.0), 1.0, "a one-sided gait about 34 degrees"),
        ({}, 0.0, (1.0, 2.0), 1.0, "more failures"),
        ({}, 0.0, (1.0, 2.0), 0.0, "the last evaluation was the best"),
        ({}, 0.0, (2.0, 1.0), 0.0, "the spread of seeds"),
    ],
)
def test_a_run_worse_than_its_row_names_a_likely_reason(
    tmp_path, changes, theta, speeds, failed, reason
):
    row, name = load_row(ROOT / report.RESULTS / "direct-ppo.npz"), "paper"
    config = replace(TRAINED_ROWS["direct-ppo"], seed=7, **changes)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": config.to_dict()}
    (tmp_path / "config.json").write_text(json.dumps(content))
    lines = [f"{step},{speed}" for step, speed in enumerate(speeds)]
    (tmp_path / "evaluations.csv").write_text("\n".join(["steps,mean_speed_cm_s", *lines]))
    speed = row.score(name, "mean_speed").mean(axis=1).min() + (1e-6 if reason is None else -1e-6)
    episodes = [{"mean_speed": speed, "failed": failed}] * 3
    text = report.compare_to_row(
        tmp_path, episodes, load_set(name), theta + 0.5 * np.sin(np.arange(100.0))
    )
    assert f"Published row direct-ppo: mean of {len(row.header['training_seeds'])} seeds" in text
    assert f"This run: {speed:.2f} cm/s" in text and (
        "worse than the row's worst seed" in text
    ) is (reason is not None)
    assert reason is None or f"A likely reason: {reason}" in text


@pytest.mark.parametrize("amplitude", [0.5, 1.5])
def test_a_recording_is_the_episode(amplitude):
    policy, one = Sine(amplitude, env_kwargs={"control_dt": 0.01}), EvaluationSet("one", (PLANT,))
    found = report.run_episode(policy, PLANT, one)
    (episode,) = evaluate(policy, one)
    # The stronger torque ends the episode early.
    assert found["t"][-1] == pytest.approx(episode["duration"], abs=0.011)
    assert found["x"][-1] == pytest.approx(episode["distance"], abs=1e-12)


@pytest.mark.parametrize("goal", [None, 0.1])
def test_a_comparison_shows_both_recordings_and_the_end_of_the_longer_one(
    tmp_path, saved_figures, goal
):
    recordings = {}
    for name, seconds in (("adaptive", 9.0), ("agent", 12.0)):
        t = np.arange(0.0, seconds + 1e-9, 0.02)
        recordings[name] = {"t": t, "x": 0.1 + 0.02 * t, "theta": np.sin(t), "torque": np.cos(t)}
    report.draw_comparison(recordings, tmp_path / "comparison.png", replace(PLANT, goal=goal))
    (figure,) = saved_figures
    displacement, angle, torque = figure.axes
    assert displacement.get_title("left") == "Plant (M = 0.6 kg, μ = 0.05)"
    speeds = [f"{name}: 2.00 cm/s" for name in ("adaptive", "agent")]
    assert texts(displacement.get_legend().texts) == speeds + ["goal"] * bool(goal)
    both = list(zip(recordings.values(), (MUTED, BLUE), strict=True))
    line = [([0.0, 1.0], [100.0 * goal] * 2, MUTED)] if goal else []
    assert_lines(
        displacement, *((each["t"], 100.0 * each["x"], colour) for each, colour in both), *line
    )
    assert_lines(angle, *((each["t"], np.degrees(each["theta"]), colour) for each, colour in both))
    assert_lines(torque, *((each["t"], each["torque"], colour) for each, colour in both))
    assert {each.get_drawstyle() for each in torque.lines} == {"steps-pre"}
    for axes, label, start in (
        (displacement, "x (cm)", 0.0),
        (angle, "θ (deg)", 5.4),
        (torque, "u (N m)", 5.4),
    ):
        assert axes.get_ylabel().endswith(label) and axes.get_xlim() == pytest.approx((start, 12.0))
