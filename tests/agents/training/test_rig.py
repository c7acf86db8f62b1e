"""Training on the ranges of an identified rig."""

import json
import re
import shutil

import pytest

import train as command_line
from agents import report
from agents.training.algorithms import make_env
from agents.training.config import read_config
from agents.training.loop import begin, train
from capsule_gym import load_policy
from tests.agents.rig import RANGES, make_fit
from tests.agents.training.small import finished, small


@pytest.fixture
def fit(tmp_path):
    """An identified rig, also in a file."""
    found = make_fit()
    found.save(tmp_path / "fit.json")
    return found


@pytest.fixture
def config(fit, tmp_path):
    return small(
        "direct", "ppo", rig=str(tmp_path / "fit.json"), total_steps=256, episode_seconds=0.2
    )


def test_training_draws_the_rig(config):
    _, info = make_env(config, 0).venv.batch.reset(seed=0)
    for name in ("M", "mu"):
        low, high = RANGES[name]
        assert low <= info[name].min() < info[name].max() <= high
    assert (info["capsule"]["m"] == 0.15).all()
    disturbances = info["disturbances"]
    assert (disturbances["lag"] == 0.004).all()
    low, high = RANGES["latency"]
    assert low <= disturbances["latency"].min() < disturbances["latency"].max() <= high


def test_a_run_keeps_its_rig(fit, config, tmp_path):
    begin(tmp_path / "run", config)
    (tmp_path / "fit.json").unlink()
    moved = tmp_path / "moved"
    shutil.move(tmp_path / "run", moved)
    assert train(moved)
    env_kwargs = load_policy(moved).env_kwargs
    for name, value in fit.env_kwargs().items():
        assert env_kwargs[name] == value
    assert train(moved, 512)
    assert read_config(moved).total_steps == 512


def test_the_comparison_runs_on_plants_of_the_rig(config, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(report, "RIG_PLANTS", 2)
    report.compare(finished(tmp_path / "run", config))
    printed = capsys.readouterr().out
    assert "plants from the ranges of the rig (2 episodes" in printed
    # Rows of the leaderboard are of other plants.
    assert "Published row" not in printed


REFUSED = {
    "--randomization wide": "--randomization must not be given with --rig, got 'wide'",
    "--row direct-ppo --randomization wide": "--randomization must not be given with --rig",
    "--disturbances real": "--disturbances must not be given with --rig, got 'real'",
    "--mass-range 0.4 0.5": r"mass_range must be None with rig, got \(0.4, 0.5\)",
    "--static-ratio 1.1": "static_ratio must be None with rig, got 1.1",
}


@pytest.mark.usefixtures("fit")
@pytest.mark.parametrize(("words", "message"), REFUSED.items())
def test_what_a_rig_determines_is_refused(tmp_path, capsys, words, message):
    run = tmp_path / "run"
    options = ["--rig", str(tmp_path / "fit.json"), "--run", str(run), "--no-comparison"]
    options += ["--total-steps", "64"]
    try:
        assert command_line.main([*words.split(), *options]) == 2
    except SystemExit as ended:
        assert ended.code == 2
    assert re.search(message, capsys.readouterr().err)
    assert not run.exists()


@pytest.mark.parametrize("text", ["{}", None])
def test_a_wrong_file_is_refused(tmp_path, capsys, text):
    path = tmp_path / "other.json"
    if text is not None:
        path.write_text(text)
    run = tmp_path / "run"
    words = ["--rig", str(path), "--run", str(run), "--no-comparison"]
    assert command_line.main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("train.py: error: --rig: ")
    assert "other.json" in error
    assert not run.exists()


def test_another_rig_is_refused_on_resumption(config, tmp_path, capsys):
    run = finished(tmp_path / "run", config)
    assert json.loads((run / "config.json").read_text())["hyperparameters"]["rig"] == "rig.json"
    other = tmp_path / "other.json"
    shutil.copy(tmp_path / "fit.json", other)
    with pytest.raises(SystemExit):
        command_line.main(["--resume", str(run), "--rig", str(other)])
    assert "--rig must not be given with --resume" in capsys.readouterr().err
