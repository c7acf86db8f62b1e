"""Tuning: the spaces of the presets, and a search that resumes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from agents.study import tune
from agents.training import loop
from agents.training.config import read_config
from agents.training.presets import PRESETS, ROWS
from tests.agents.training.small import small

optuna = pytest.importorskip("optuna", reason="the extra `tune` is not installed", exc_type=ImportError)


def sample(seed):
    return optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=seed)).ask()


@pytest.mark.parametrize(("task", "algo"), PRESETS)
def test_every_point_of_a_space_is_a_configuration(task, algo):
    for seed in range(20):
        config = dataclasses.replace(PRESETS[task, algo], **tune.suggest(sample(seed), algo))
        config.check()
        assert config.final_learning_rate <= config.learning_rate


def test_a_search_resumes_where_it_was_stopped(tmp_path, monkeypatch, capsys):
    stopped = [True]

    def train(run, report):
        gamma = read_config(run).gamma
        lines = [{"steps": 512.0, "score_cm_s": 5.0}, {"steps": 1024.0, "score_cm_s": gamma}]
        text = "".join(f"{line['steps']},{line['score_cm_s']}\n" for line in lines)
        (run / "evaluations.csv").write_text(f"steps,score_cm_s\n{text}")
        report(lines[:1])
        report(lines)
        return not stopped.pop() if stopped else True

    monkeypatch.setattr(loop, "train", train)
    monkeypatch.setitem(ROWS, "tiny", small("direct", "ppo"))
    monkeypatch.setitem(tune.SPACES, "ppo", {"learning_rate": (1e-4, 1e-3), "one_minus_gamma": (1e-3, 1e-1)})
    words = ["tiny", "--trials", "2", "--total-steps", "1024", "--runs", str(tmp_path)]
    # Ctrl-C interrupts the first trial; the resumed search repeats it with the same parameters.
    assert tune.main(words) == 130
    with pytest.raises(SystemExit):
        tune.main(words)
    assert "contains a search: --resume continues" in capsys.readouterr().err
    words.insert(1, "--resume")
    assert tune.main(words) == 0
    content = json.loads((tmp_path / "tiny" / "trials.json").read_text())
    assert [trial["state"] for trial in content["trials"]] == ["complete", "complete"]
    assert [trial["score"] for trial in content["trials"]] == [5.0, 5.0]
    first, second = (trial["parameters"] for trial in content["trials"])
    assert first != second
    assert len([path for path in (tmp_path / "tiny").glob("*") if path.is_dir()]) == 2
    assert content["trials"][0]["evaluations"][0] == {"steps": 512.0, "score_cm_s": 5.0}
    # The search has reached the number of trials.
    assert tune.main(words) == 0
    assert json.loads((tmp_path / "tiny" / "trials.json").read_text())["trials"] == content["trials"]
    assert "Best of 2 complete trials: 5.00 cm/s" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        tune.main([*words[:-3], "2048", *words[-2:]])
    assert "other settings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nope"], "got 'nope'"),
        (["direct-ppo", "--trials", "0"], "--trials must be an integer >= 1, got 0"),
        (["direct-ppo", "--seed", "5e9"], "seed must be an integer"),
    ],
)
def test_bad_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as end:
        tune.main(words)
    assert end.value.code == 2
    assert message in capsys.readouterr().err


def test_off_policy_trials_make_the_same_number_of_updates():
    base = tune.Args("direct-sac", total_steps=64_000).settings()
    assert base == dataclasses.replace(
        PRESETS["direct", "sac"], seed=tune.FIRST_SEED, total_steps=64_000, evaluate_every=8_000
    )
    updates = set()
    for seed in range(8):
        config = tune.config_of(sample(seed), base)
        updates.add(config.total_steps // config.num_envs * config.gradient_steps)
        assert config.evaluate_every * 8 == config.total_steps
    assert updates == {64_000 // base.num_envs * base.gradient_steps}


def test_a_preset_is_the_best_trial_of_its_committed_search():
    content = json.loads((Path(tune.__file__).parent / "data" / "direct-recurrent-ppo.json").read_text())
    complete = [trial for trial in content["trials"] if trial["state"] == "complete"]
    first = max(complete, key=lambda trial: trial["score"])
    found = tune.suggest(optuna.trial.FixedTrial(first["parameters"]), "recurrent-ppo")
    preset = PRESETS["direct", "recurrent-ppo"].to_dict()
    # Rounded to two or three digits.
    assert {name: preset[name] for name in found} == pytest.approx(found, rel=5e-3)
