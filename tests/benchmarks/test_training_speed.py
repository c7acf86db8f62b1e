"""Steps per second of trainings: nothing here measures a time."""

from __future__ import annotations

import json

import pytest
import torch

from benchmarks import training_speed
from benchmarks.trainers import ppo, sac

TINY = {"num_envs": 4, "hidden": 8, "batch_size": 16}


def test_every_axis_is_measured_and_written(tmp_path, capsys, monkeypatch):
    rivals = (ppo("ppo", n_steps=8, **TINY), sac("sac", learning_starts=20, **TINY))
    slow = (ppo("one by one", own=False, vec_env="DummyVecEnv", n_steps=8, **TINY),)
    monkeypatch.setattr(training_speed, "AXES", {"both": rivals, "slow": slow})
    before = torch.get_num_threads()
    files = ["--json", str(tmp_path / "speed.json"), "--markdown", str(tmp_path / "speed.md")]
    assert training_speed.main(["--axes", "both", "slow", "--turns", "2", "--seconds", "0.02", *files]) == 0
    assert torch.get_num_threads() == before
    rates = json.loads((tmp_path / "speed.json").read_text())["env_steps_per_second"]
    assert set(rates) == {"both", "slow"} and len(rates["both"]["sac"]) == 2
    page = (tmp_path / "speed.md").read_text()
    assert page.startswith("<!-- Written by python -m benchmarks.training_speed: do not edit. -->\n")
    assert "[start:both]" in page and "[end:slow]" in page
    assert "gradient updates/s" in capsys.readouterr().out


def test_ratios_are_to_the_first_of_an_axis_turn_by_turn():
    first, other = ppo("first", batch_size=1024, n_epochs=4), ppo("other")
    header, own, row = training_speed.rows((first, other), {"first": [10.0, 20.0], "other": [20.0, 30.0]})
    cells = dict(zip(header, row, strict=True))
    assert cells["ratio"] == "1.75" and cells["range of the ratio"] == "1.50 to 2.00"
    assert own[-1] == "" and first.updates == 4 / 1024


def test_the_first_of_each_axis_has_a_name_of_its_own():
    for trainers in training_speed.AXES.values():
        assert len({trainer.name for trainer in trainers}) == len(trainers)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--axes", "sideways"], "sideways"),
        (["--turns", "0"], "--turns"),
        (["--seconds", "0"], "--seconds"),
        (["--json", __file__], "--json"),
    ],
)
def test_bad_options_are_named(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        training_speed.main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
