"""The report of policies, and the comparison at the end of training."""

import dataclasses
import html
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from agents import report
from agents.leaderboard.rows import evaluate as evaluate_rows
from agents.leaderboard.rows import load_row
from agents.training.presets import ROWS
from baselines.evaluation.episodes import evaluate
from capsule_gym.evaluation_sets import SET_NAMES, EvaluationSet, PlantSpec, load_set
from tests.agents.fakes import Sine, write_run
from tests.agents.training.small import small

ROOT = Path(__file__).resolve().parents[2]
NAME = "a$\\bad$b"  # must not be read as a formula
PLANT = PlantSpec(0.6, 0.05, seed=3)


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    """Short episodes and small figures."""
    monkeypatch.setattr(report, "DPI", 50)
    monkeypatch.setattr(report, "evaluate_rows", partial(evaluate_rows, horizon=0.2))


def make_run(folder, env="CapsuleStickSlip-v0", columns="mean_speed_cm_s", **options):
    """Writes the files of a finished run that the comparison and a report read."""
    write_run(folder, 3, **options)
    (folder / "evaluations.csv").write_text(f"steps,{columns},failed\n100,1.0,0\n200,2.0,0\n")
    hyperparameters = {**small("direct", "ppo").to_dict(), "env": env}
    content = {"task": "direct", "algo": "ppo", "hyperparameters": hyperparameters}
    (folder / "config.json").write_text(json.dumps(content))


def test_a_report_shows_the_numbers_of_the_leaderboard(tmp_path):
    make_run(tmp_path / NAME)
    text = report.render(["direct-ppo", str(tmp_path / NAME)])
    # Every picture is inside of the page: learning curves, cost of transport and performance profiles.
    assert re.findall(r"src='(data:image/\w+)", text) == ["data:image/png"] * 3
    assert not re.search(r"(src|href)=['\"](?!data:)", text)
    assert f"<h1>direct-ppo, {NAME}</h1>" in html.unescape(text)
    board = json.loads((ROOT / "leaderboard.json").read_text())
    rows = {row["policy"]: row["results"] for row in board["rows"]}
    # The report omits the sets of 1,000 plants, which would take too long.
    tables = dict(re.findall(r"<h2>Set (\w+)</h2>(.*?)</table>", text, re.DOTALL))
    assert list(tables) == list(SET_NAMES)
    for name, table in tables.items():
        lines = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in table.splitlines() if "<td" in line]
        shown = {html.unescape(policy.strip()): [cell.strip() for cell in cells] for policy, *cells in lines}
        assert set(shown) == {"direct-ppo", "adaptive", NAME}
        for policy in ("direct-ppo", "adaptive"):
            result = rows[policy][name]
            assert shown[policy][0] == f"{result['failures']}/{result['episodes']}"
            assert shown[policy][1].startswith(f"{result['mean_speed']['iqm']:.2f} [")
            assert ("share of optimum" in table) is ("share_of_optimum" in result)


GOAL = {"env_kwargs": {"task": "goal"}, "mean": np.zeros(8), "variance": np.ones(8)}
GOAL["layers"] = ((np.zeros((1, 8), np.float32), np.zeros(1, np.float32)),)


@pytest.mark.parametrize(
    ("env", "columns", "options", "plant", "shown"),
    [
        ("CapsuleStickSlip-v0", "mean_speed_cm_s", {}, {"M": 0.5, "mu": 0.01}, "cost of transport"),
        ("CapsuleGoal-v0", "goal_time_s,success", GOAL, {"M": 0.5, "mu": 0.2, "goal": 0.1}, "share of goals reached"),
    ],
)
def test_a_finished_run_is_compared_and_drawn(tmp_path, monkeypatch, capsys, env, columns, options, plant, shown):
    monkeypatch.setattr(report, "SHOWN", 0.08)
    folder, set_file = tmp_path / NAME, tmp_path / "two.json"
    make_run(folder, env, columns, **options)
    task = options.get("env_kwargs", {}).get("task", "speed")
    plants = [{**plant, "seed": n} for n in range(2)]
    set_file.write_text(json.dumps({"name": "two", "task": task, "plants": plants}))
    report.compare(folder, str(set_file))
    out = capsys.readouterr().out
    assert all(word in out for word in ("mean speed", "peak torque", "failures", "difference", shown))
    for name in ("comparison.png", "animation.gif", "report.html"):
        assert (folder / name).stat().st_size > 1000
    assert not list(folder.glob("*.tmp*"))
    text = (folder / "report.html").read_text()
    assert f"<h1>{NAME}</h1>" in html.unescape(text) and ("time to the goal (s)" in text) is (task == "goal")
    if task == "goal":
        with pytest.raises(ValueError, match=r"for the same task, got .+ for goal and direct-ppo"):
            report.render([str(folder), "direct-ppo"])


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
def test_a_run_worse_than_its_row_names_a_likely_reason(tmp_path, changes, theta, speeds, failed, reason):
    row, name = load_row(ROOT / report.RESULTS / "direct-ppo.npz"), "paper"
    config = dataclasses.replace(ROWS["direct-ppo"], seed=7, **changes)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": config.to_dict()}
    (tmp_path / "config.json").write_text(json.dumps(content))
    lines = [f"{step},{speed}" for step, speed in enumerate(speeds)]
    (tmp_path / "evaluations.csv").write_text("\n".join(["steps,mean_speed_cm_s", *lines]))
    worst = row.score(name, "mean_speed").mean(axis=1).min()
    speed = worst + (1e-6 if reason is None else -1e-6)
    episodes = [{"mean_speed": speed, "failed": failed}] * 3
    text = report.compare_to_row(tmp_path, episodes, load_set(name), theta + 0.5 * np.sin(np.arange(100.0)))
    assert f"Published row direct-ppo: mean of {len(row.header['training_seeds'])} seeds" in text
    assert f"This run: {speed:.2f} cm/s" in text
    assert ("worse than the row's worst seed" in text) is (reason is not None)
    assert reason is None or f"A likely reason: {reason}" in text


@pytest.mark.parametrize("limit", [1.5, 1.0])
def test_a_recording_is_the_motion_of_the_episode(limit):
    law = {} if limit == 1.5 else {"controller": "baselines:adaptive", "residual_limit": limit}
    policy, one = Sine(0.5, env_kwargs={"control_dt": 0.01, **law}), EvaluationSet("one", (PLANT,))
    found, pictures = report.record(policy, PLANT, one, 1.0, frames=True)
    (episode,) = evaluate(policy, one, horizon=1.0)
    assert 100.0 * found["x"][-1] == pytest.approx(100.0 * episode["distance"], abs=1e-10)
    assert found["t"][-1] == pytest.approx(1.0) and found["t"].shape == found["torque"].shape
    assert np.abs(found["torque"]).max() <= episode["peak_torque"]
    assert len({picture.tobytes() for picture in pictures}) == len(pictures) > 20


def test_two_policies_of_one_name_are_refused(tmp_path):
    for folder in (tmp_path / NAME, tmp_path / "other" / NAME):
        write_run(folder, 4)
    with pytest.raises(ValueError, match=f"different names, got {re.escape(NAME)} more than once"):
        report.render([str(tmp_path / NAME), str(tmp_path / "other" / NAME)])


def test_a_link_out_of_a_runs_folder_is_no_part_of_its_page(tmp_path):
    make_run(tmp_path / "run")
    log = tmp_path / "run" / "evaluations.csv"
    log.rename(tmp_path / "private.csv").touch()
    log.symlink_to(tmp_path / "private.csv")
    with pytest.raises(ValueError, match=r"evaluations.csv must be a file in the run's folder.*private.csv"):
        report.find_run(str(tmp_path / "run"))
