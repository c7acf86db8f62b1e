"""Reproduction: whether one more run agrees with the published ones."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest

from agents import reproduce
from agents.distillation import dagger
from agents.evaluation.policies import CHECKPOINTS, checkpoint_names
from agents.reproduce import prediction_interval


def test_one_more_value_lies_in_its_prediction_interval_19_times_of_20():
    draws = np.random.default_rng(0).normal(16.0, 0.3, size=(1000, 6))
    inside = [low <= value <= high for *known, value in draws for low, high in [prediction_interval(known)]]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.025)
    assert prediction_interval([3.0]) == (-math.inf, math.inf)


def test_every_checkpoint_is_reproduced():
    assert set(checkpoint_names()) <= set(reproduce.PUBLISHED)


def train_again(jobs, *_):
    """Runs that have learned what published ones have learned."""
    for job in jobs:
        shutil.copytree(CHECKPOINTS / job.row / "seed-0", job.run / "best")
        (job.run / "evaluations.csv").write_text("steps,core_seconds\n100,120.0\n")
    return {}


def test_published_runs_lie_within_the_intervals_of_their_rows(tmp_path, monkeypatch, capsys):
    def distil_all(name, folders):
        for folder in folders.values():
            shutil.copytree(CHECKPOINTS / name / "seed-0", folder)
            result = {"mean_speed": 20.0, "failed": 0.0, "core_seconds": 90.0, "revision": "0123456789ab"}
            (folder / "finished.json").write_text(json.dumps(result))
        return True

    monkeypatch.setattr(dagger, "distil_all", distil_all)
    monkeypatch.setattr(reproduce, "train_all", train_again)
    assert reproduce.main(["direct-ppo", "optimum-distilled", "--runs", str(tmp_path)]) == 0
    direct, distilled = (line for line in capsys.readouterr().out.splitlines() if line.endswith("within"))
    assert direct.startswith("direct-ppo") and "(5)" in direct and " 2.0 " in direct
    assert distilled.startswith("optimum-distilled") and "(5)" in distilled and " 1.5 " in distilled


def test_a_failed_run_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reproduce, "train_all", lambda jobs, *_: dict.fromkeys(jobs, "lost"))
    assert reproduce.main(["direct-ppo", "--runs", str(tmp_path)]) == 1
    assert "direct-ppo failed: lost" in capsys.readouterr().err


def test_bad_options_are_named(capsys):
    for words, message in ((["nope"], "got 'nope'"), (["--seed", "5e9"], "--seed"), (["--jobs", "0"], "--jobs")):
        with pytest.raises(SystemExit):
            reproduce.main(words)
        assert message in capsys.readouterr().err
