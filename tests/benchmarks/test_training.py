"""Learning curves of contenders: the trainings, their going on, and what is said of them."""

from __future__ import annotations

import json
import math

import pytest
import torch

from benchmarks import training
from benchmarks.trainers import Run, ppo

TINY = {"num_envs": 8, "n_steps": 4, "batch_size": 32, "hidden": 8, "evaluation_episodes": 2}


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(training, "PRESET", ppo("own", **TINY))
    monkeypatch.setattr(training, "PEER", ppo("plain", own=False, **TINY))
    monkeypatch.setattr(training, "OTHERS", (ppo("other", activation="relu", **TINY),))


def test_contenders_are_compared_and_a_comparison_goes_on(tiny, tmp_path, capsys):
    options = ["--seeds", "0-1", "--total-steps", "1024", "--runs", str(tmp_path / "runs")]
    before = torch.get_num_threads()
    assert training.main([*options, "--other-seeds", "--json", str(tmp_path / "a.json")]) == 0
    assert torch.get_num_threads() == before
    finished = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").iterdir()}
    assert len(finished) == 4
    files = ["--json", str(tmp_path / "b.json"), "--markdown", str(tmp_path / "b.md")]
    files += ["--figure", str(tmp_path / "curves.png")]
    assert training.main([*options, "--other-seeds", "0", *files]) == 0
    assert all(path.stat().st_mtime_ns == then for path, then in finished.items())
    assert len(list((tmp_path / "runs").iterdir())) == 5
    runs = json.loads((tmp_path / "b.json").read_text())["runs"]
    assert [(run["name"], run["seed"]) for run in runs] == [
        ("own", 0),
        ("own", 1),
        ("plain", 0),
        ("plain", 1),
        ("other", 0),
    ]
    for run in runs:
        assert run["steps"] == list(range(64, 1025, 64))
        assert run["seconds"] == sorted(run["seconds"])
        assert len(run["mean_speed"]) == len(run["failed"]) == len(run["steps"])
    assert "| other " in (tmp_path / "b.md").read_text()
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "times the steps per second" in capsys.readouterr().out


def test_what_is_finished_before_ctrl_c_counts(tiny, tmp_path, monkeypatch, capsys):
    from benchmarks import training_runs

    train, trained = training_runs.train, []

    def interrupted(trainer, every):
        if len(trained) == 4:
            raise KeyboardInterrupt
        trained.append(trainer.name)
        return train(trainer, every)

    monkeypatch.setattr(training_runs, "train", interrupted)
    options = ["--seeds", "0-1", "--other-seeds", "0", "--total-steps", "64", "--runs", str(tmp_path)]
    assert training.main(options) == 1
    assert "Stopped" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == 4


def run(seed, speeds, seconds=(1.0, 2.0, 3.0)):
    return Run("x", seed, [100, 200, 300], list(seconds), list(speeds), [0.0] * 3)


def test_a_run_says_how_far_it_was_and_when():
    first = run(0, (1.0, 5.0, 4.0))
    assert first.rate == 100.0
    assert first.at(0.5) == 1.0 and first.at(0.7) == 5.0 and first.at(1.0) == 4.0
    assert first.seconds_to(4.0) == 2.0 and first.seconds_to(5.5) == math.inf


def test_points_are_counted_by_the_peers_interval():
    peers = [run(seed, (1.0 + seed, 1.0 + seed, 1.0 + seed)) for seed in range(2)]
    own = [run(seed, (0.5, 1.5, 2.5)) for seed in range(2)]
    assert [steps.tolist() for steps in training.compared(own, peers)] == [[100.0], [200.0], [300.0]]
    assert training.speed_difference(own, own).value == 0.0


def test_ratios_are_seed_by_seed():
    fast, slow = [run(seed, (0.0,) * 3, (0.1, 0.2, 0.3 + seed)) for seed in range(2)], [run(1, (0.0,) * 3)]
    assert training.ratios(fast, slow) == pytest.approx([3.0 / 1.3])


def test_the_peer_is_the_former_preset_whatever_is_todays():
    from benchmarks.trainers import FORMER

    changes = training.PEER.config.to_dict()
    assert all(changes[name] == value for name, value in FORMER.items())
    assert not training.PEER.own and training.PEER.config.task == "direct"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--json", __file__], "--json"),
        (["--figure", "nowhere/curves.png"], "--figure"),
        (["--seeds", "1"], "--seeds"),
        (["--other-seeds", "a"], "--other-seeds"),
        (["--total-steps", "0"], "--total-steps"),
    ],
)
def test_bad_options_are_named(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        training.main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
