"""The search: on own draws, gone on with where it was, with nothing counted twice."""

from __future__ import annotations

import dataclasses
import json

import pytest

from agents.study import tune
from agents.training.presets import PRESETS, ROWS
from agents.training.stopping import Stop
from tests.agents.study.small import small

optuna = pytest.importorskip("optuna", reason="the extra `tune` is not installed", exc_type=ImportError)


@pytest.fixture
def tiny(monkeypatch):
    """A row whose trials take a second, and a search in one direction."""
    monkeypatch.setitem(ROWS, "tiny", small("direct", "ppo"))
    monkeypatch.setitem(tune.SPACES, "ppo", lambda trial: {"gamma": trial.suggest_float("gamma", 0.9, 0.999)})


@pytest.mark.parametrize(("task", "algo"), PRESETS)
def test_every_point_of_a_space_is_a_configuration(task, algo):
    preset, space = PRESETS[task, algo], tune.SPACES[algo]
    for seed in range(20):
        study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
        config = dataclasses.replace(preset, **space(study.ask()))
        config.check()
        assert config.final_learning_rate <= config.learning_rate


def test_a_search_goes_on_where_it_was_stopped(tmp_path, tiny, capsys):
    options = tune.Options("tiny", trials=1, total_steps=1024, runs=tmp_path)
    stop = Stop()
    stop.requested = True
    study = tune.Search(options, stop).run()
    assert tune.ended(study) == []
    words = ["tiny", "--trials", "2", "--total-steps", "1024", "--runs", str(tmp_path)]
    assert tune.main(words) == 0
    content = json.loads((tmp_path / "tiny" / "trials.json").read_text())
    assert [trial["state"] for trial in content["trials"]] == ["complete", "complete"]
    first, second = content["trials"]
    # The one that was stopped, and a new one.
    assert first["parameters"] == study.trials[0].params != second["parameters"]
    lines = [dict(zip(content["evaluations"], line, strict=True)) for line in first["evaluations"]]
    assert first["score"] == max(line["score"] for line in lines)
    assert lines[-1]["steps"] == 1024
    # Enough of them: nothing is trained any more.
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "tiny").rglob("model.zip")}
    assert tune.main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "tiny").rglob("model.zip")} == before
    assert "gamma=" in capsys.readouterr().out
    # Another length is another search.
    with pytest.raises(SystemExit):
        tune.main([*words[:-3], "2048", *words[-2:]])
    assert "other settings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nope"], "got 'nope'"),
        (["direct-ppo", "--trials", "0"], "--trials must be an integer >= 1, got 0"),
        (["direct-ppo", "--jobs", "-1"], "--jobs must be an integer >= 1, got -1"),
        (["direct-ppo", "--seed", "5e9"], "seed must be an integer"),
    ],
)
def test_bad_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as end:
        tune.main(words)
    assert end.value.code == 2
    assert message in capsys.readouterr().err


def test_a_preset_is_searched_by_its_name_and_all_trials_make_as_many_updates(tmp_path):
    search = tune.Search(tune.Options("direct-td3", total_steps=64_000, runs=tmp_path), Stop())
    assert search.settings == dataclasses.replace(
        PRESETS["direct", "td3"], seed=tune.FIRST_SEED, total_steps=64_000, evaluate_every=8_000
    )
    updates = set()
    for seed in range(8):
        study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed))
        config = search.config_of(study.ask())
        updates.add(config.total_steps // config.num_envs * config.gradient_steps)
        assert config.evaluate_every * 8 == config.total_steps
    assert updates == {64_000 // search.settings.num_envs * search.settings.gradient_steps}


@pytest.mark.parametrize("algo", ["sac", "td3", "tqc", "recurrent-ppo"])
def test_a_preset_is_the_best_trial_of_its_committed_search(algo):
    content = json.loads((tune.DATA / f"direct-{algo}.json").read_text())
    whole = [trial for trial in content["trials"] if trial["state"] == "complete"]
    first = max(whole, key=lambda trial: trial["score"])
    found = tune.SPACES[algo](optuna.trial.FixedTrial(first["parameters"]))
    preset = PRESETS["direct", algo].to_dict()
    # Rounded to two or three digits.
    assert {name: preset[name] for name in found} == pytest.approx(found, rel=5e-3)
