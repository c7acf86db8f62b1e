import html
import json
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from agents.leaderboard.rows import evaluate_run
from agents.report import __main__ as report
from agents.report import page
from capsule_gym.evaluation_sets import SET_NAMES
from tests.agents.fakes import write_run
from tests.agents.training.small import small

ROOT = Path(__file__).resolve().parents[2]


NAME = "a$\\bad$b"  # must not be read as a formula


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a run with the files that a report reads."""
    folder = tmp_path_factory.mktemp("runs") / NAME
    write_run(folder, 3)
    (folder / "evaluations.csv").write_text("steps,mean_speed_cm_s,failed\n100,1.0,0\n200,2.0,0\n")
    (folder / "animation.gif").write_bytes(b"GIF89a")
    return folder


@pytest.fixture(scope="module")
def both(run):
    """A row of the leaderboard, the run after short episodes, and the paper's controller."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "evaluate_run", partial(evaluate_run, horizon=0.6))
        return page.collect(["direct-ppo", str(run)])


def test_a_report_shows_the_numbers_of_the_leaderboard(both, monkeypatch):
    monkeypatch.setattr(page, "DPI", 50)
    text = page.render(both, "A <title>")
    # Every picture is inside of the page: the animation, the learning curve and three more figures.
    assert re.findall(r'src="(data:image/\w+)', text) == ["data:image/gif", *["data:image/png"] * 4]
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert "<title>A &lt;title&gt;</title>" in text and "<h1>A &lt;title&gt;</h1>" in text
    assert "Learning curve on validation plants" in text and f"{NAME} in motion on the nominal plant" in text
    board = json.loads((ROOT / "leaderboard.json").read_text())
    tables = text.split("<h3>")[1:]
    # The report omits the sets of 1,000 plants, which would take too long.
    assert [each.partition("<")[0] for each in tables] == list(SET_NAMES)
    rows = {row["policy"]: row["results"] for row in board["rows"]}
    for name in ("paper", "wide"):
        result = rows["direct-ppo"][name]
        assert f"{result['failures']} of {result['episodes']} on <code>{name}</code>" in text
    for table, name in zip(tables, SET_NAMES, strict=True):
        lines = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in table.splitlines() if "<td" in line]
        shown = {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}
        assert list(shown) == [row.name for row in both.results.rows]
        for policy in ("direct-ppo", "adaptive"):
            result = rows[policy][name]
            assert shown[policy][0] == f"{result['failures']}/{result['episodes']}"
            assert shown[policy][1].startswith(f"{result['mean_speed']['iqm']:.2f} [")
            assert (shown[policy][-1] == "-") == ("share_of_optimum" not in result)


def test_a_finished_run_is_compared_and_drawn(run, both, tmp_path, capsys, monkeypatch):
    rows = tuple(row for row in both.results.rows if row.name != "direct-ppo")
    mine = both._replace(results=replace(both.results, rows=rows))
    monkeypatch.setattr(page, "collect", lambda *names, **options: mine)
    monkeypatch.setattr(page, "_figure", lambda *arguments: "")
    folder, set_file = tmp_path / NAME, tmp_path / "two.json"
    shutil.copytree(run, folder)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": small("direct", "ppo").to_dict()}
    (folder / "config.json").write_text(json.dumps(content))
    set_file.write_text(json.dumps({"name": "two", "plants": [{"M": 0.5, "mu": 0.01, "seed": n} for n in range(2)]}))
    monkeypatch.setattr(page, "ANIMATION_SECONDS", 0.08)
    monkeypatch.setattr(page, "ANIMATION_START", 0.04)
    page.compare(folder, str(set_file))
    out = capsys.readouterr().out
    for word in ("mean speed", "cost of transport", "peak torque", "failures", "difference", "adaptive"):
        assert word in out
    for name in ("comparison.png", "animation.gif", "report.html"):
        assert (folder / name).stat().st_size > 1000
    assert not list(folder.glob("*.tmp*"))
    assert f"<h1>{NAME}</h1>" in html.unescape((folder / "report.html").read_text())


def test_a_run_in_another_task_is_reported_by_its_metrics(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(page, "ANIMATION_SECONDS", 0.08)
    monkeypatch.setattr(page, "DPI", 50)
    monkeypatch.setattr(page, "evaluate_run", partial(evaluate_run, horizon=0.2))
    folder, set_file = tmp_path / "mine", tmp_path / "two.json"
    options = {"env_kwargs": {"task": "goal"}, "mean": np.zeros(8), "variance": np.ones(8)}
    write_run(folder, 3, **options, layers=((np.zeros((1, 8), np.float32), np.zeros(1, np.float32)),))
    (folder / "evaluations.csv").write_text("steps,goal_time_s,success,failed\n100,9.0,0.5,0\n200,2.0,0.9,0\n")
    hyperparameters = {**small("direct", "ppo").to_dict(), "env": "CapsuleGoal-v0"}
    content = {"task": "direct", "algo": "ppo", "hyperparameters": hyperparameters}
    (folder / "config.json").write_text(json.dumps(content))
    plants = [{"M": 0.5, "mu": 0.2, "seed": n, "goal": 0.1} for n in range(2)]
    set_file.write_text(json.dumps({"name": "two", "task": "goal", "plants": plants}))
    page.compare(folder, str(set_file))
    assert "share of goals reached" in capsys.readouterr().out
    text = (folder / "report.html").read_text()
    assert "time to the goal (s)" in text and "<code>goal-pulses</code> has" in text and "share of optimum" not in text
    assert re.findall("<h3>(.*)</h3>", text) == ["goal", "goal-paper"]
    with pytest.raises(ValueError, match=r"must be for the same task, got .+ for goal and direct-ppo"):
        page.collect([str(folder), "direct-ppo"])


def test_two_policies_of_one_name_are_refused(run, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "evaluate_run", partial(evaluate_run, horizon=0.2))
    write_run(tmp_path / "other" / NAME, 4)
    with pytest.raises(ValueError, match=f"different names, got {re.escape(NAME)} more than once"):
        page.collect([str(run), str(tmp_path / "other" / NAME)])


def test_an_existing_file_is_kept(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.html").write_text("mine")
    with pytest.raises(SystemExit):
        report.main(["adaptive", "-o", "there.html"])
    assert "--output must name a new file unless --overwrite is given" in capsys.readouterr().err
    assert (tmp_path / "there.html").read_text() == "mine"
