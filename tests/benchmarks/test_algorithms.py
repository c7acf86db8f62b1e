"""Algorithms side by side: one table out of runs that are gone on with."""

from __future__ import annotations

import json
import re

import pytest

from agents.evaluation.sets import load_set
from agents.training.presets import PRESETS
from benchmarks import algorithms
from tests.agents.training.small import small


def two_plants(folder):
    plants = [{"M": 0.5, "mu": 0.01, "seed": seed, "changes": []} for seed in range(2)]
    path = folder / "two.json"
    path.write_text(json.dumps({"name": "two", "plants": plants}))
    return path


def test_presets_are_trained_evaluated_once_and_gone_on_with(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(PRESETS, ("direct", "recurrent-ppo"), small("direct", "recurrent-ppo", total_steps=1024))
    monkeypatch.setitem(PRESETS, ("direct", "td3"), small("direct", "td3", total_steps=1024))
    words = ["td3", "recurrent-ppo", "--part", "0.5", "--set", str(two_plants(tmp_path)), "--jobs", "2"]
    words += ["--runs", str(tmp_path / "runs"), "--overwrite", "--json", str(tmp_path / "a.json")]
    assert algorithms.main([*words, "--seeds", "0"]) == 0
    models = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("model.zip")}
    assert algorithms.main([*words, "--seeds", "0", "--markdown", str(tmp_path / "a.md")]) == 0
    assert {path: path.stat().st_mtime_ns for path in models} == models
    content = json.loads((tmp_path / "a.json").read_text())
    for name in ("td3", "recurrent-ppo"):
        result = content["contenders"][name]
        assert (result["settings"]["algo"], result["set"]) == (name, "two")
        assert result["summary"]["training_seeds"] == [0]
        assert [run["steps"] for run in result["runs"]] == [512]
        assert result["runs"][0]["core_seconds"] > 0.0
    page = (tmp_path / "a.md").read_text()
    assert re.search(r"^\| recurrent-ppo +\| 1 +\|", page, re.M) and "0.5 of the settings' steps" in page
    assert "minutes of one core" in capsys.readouterr().out


def test_what_remembers_is_compared_at_equal_steps_on_the_plants_it_is_trained_on(tmp_path, monkeypatch):
    monkeypatch.setitem(PRESETS, ("direct", "recurrent-ppo"), small("direct", "recurrent-ppo", total_steps=1024))
    contenders = algorithms.memories()
    assert {config.total_steps for config in contenders.values()} == {1024}
    assert {config.randomization for config in contenders.values()} == {"wide"}
    plain, identifies = contenders["wide-ppo"], contenders["wide-ppo-identifies"]
    assert {**plain.to_dict(), "identifies": True} == identifies.to_dict()
    few, asked = load_set(str(two_plants(tmp_path))), []
    monkeypatch.setattr(algorithms, "load_set", lambda name: asked.append(name) or few)
    words = ["wide-recurrent-ppo", "--seeds", "0", "--runs", str(tmp_path / "runs")]
    assert algorithms.main([*words, "--markdown", str(tmp_path / "a.md")]) == 0
    assert asked == ["wide"]
    page = (tmp_path / "a.md").read_text()
    assert "[start:memory]" in page and "[start:algorithms]" not in page


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nope"], "NAME must be one of ppo, sac,"),
        (["--part", "0"], "--part must be a finite number > 0"),
        (["--seeds", "x"], "--seeds must be integers"),
        (["--set", "nowhere"], "nowhere"),
    ],
)
def test_bad_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as end:
        algorithms.main(words)
    assert end.value.code == 2
    assert message in capsys.readouterr().err


def test_a_search_is_told_by_its_best_whole_trial_and_all_that_it_cost(tmp_path):
    trials = [
        {"score": 3.0, "evaluations": [[10, 1.5, 60.0], [20, 3.0, 90.0]]},
        {"score": None, "evaluations": [[10, 9.0, 30.0]]},
        {"score": 5.0, "evaluations": [[40, 5.0, 240.0]]},
    ]
    content = {"row": "a", "evaluations": ["steps", "score", "core_seconds"], "trials": trials}
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert algorithms.searches(tmp_path)[1:] == [["a", "3", "1", "5.00", "4.00", "40", "6"]]
