"""Reproduction: when one more run is what the published ones let expect."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest
from scipy import stats

from agents import reproduce
from agents.distil import outcome
from agents.distil.students import STUDENTS
from agents.evaluation.policies import CHECKPOINTS, checkpoint_names
from agents.reproduce import STUDENT, Verdict, prediction_interval
from agents.study.jobs import Outcome
from agents.training.presets import ROWS


def test_the_quantiles_are_students():
    assert STUDENT == tuple(round(float(stats.t.ppf(0.975, n)), 3) for n in range(1, len(STUDENT) + 1))


def test_one_more_value_lies_in_its_prediction_interval_19_times_of_20():
    draws = np.random.default_rng(0).normal(16.0, 0.3, size=(4000, 6))
    inside = [low <= value <= high for *known, value in draws for low, high in [prediction_interval(known)]]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.012)
    assert prediction_interval([3.0]) == (-math.inf, math.inf)


@pytest.mark.parametrize(
    ("speed", "words"), [(9.0, "within"), (4.0, "below"), (16.0, "above"), (14.9, "within"), (5.1, "within")]
)
def test_the_verdict_says_where_a_run_lies(speed, words):
    assert Verdict("row", "paper", speed, "0/100", (9.0, 10.0, 11.0), 60.0).words == words


@pytest.mark.parametrize("published", [(), (9.0,)])
def test_nothing_follows_from_a_single_published_run(published):
    verdict = Verdict("row", "paper", 1.0, "0/100", published, 60.0)
    assert verdict.words.endswith("nothing to compare with")
    assert verdict.cells()[3] == ""


@pytest.mark.parametrize("row", reproduce.PUBLISHED)
def test_a_row_is_compared_on_plants_as_it_was_trained_on(row):
    settings = ROWS.get(row) or STUDENTS[row]
    assert reproduce.set_of(row) in (settings.randomization, "paper")


def test_every_checkpoint_is_reproduced():
    assert set(checkpoint_names()) <= set(reproduce.PUBLISHED)


def trained(job):
    """A run that learned what a published one has learned."""
    shutil.copytree(CHECKPOINTS / job.row / "seed-0", job.run / "best")
    shutil.copy(job.run / "best" / "policy.safetensors", job.run)
    columns = "steps,seconds,mean_speed_cm_s,failed,score_cm_s,stage"
    (job.run / "evaluations.csv").write_text(f"{columns}\n100,120.0,1.0,0.0,1.0,0\n")
    return Outcome(job, "finished")


def test_a_published_run_lies_within_its_own_rows_interval(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reproduce, "train_all", lambda jobs, *_: [trained(job) for job in jobs])
    assert reproduce.main(["direct-ppo", "--runs", str(tmp_path)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("direct-ppo")]
    assert line.endswith("within") and "2 min" in line and "(5)" in line


def test_a_student_is_taught_anew_and_compared(tmp_path, monkeypatch, capsys):
    def teach(name, folders, budget):
        assert budget == STUDENTS[name].budget
        for folder in folders.values():
            shutil.copytree(CHECKPOINTS / name / "seed-0", folder)
            result = {"mean_speed": 20.0, "failed": 0.0, "core_seconds": 90.0, "revision": "0123456789ab"}
            (folder / "finished.json").write_text(json.dumps(result))
        return True

    monkeypatch.setattr(outcome, "teach", teach)
    assert reproduce.main(["optimum-distilled", "--runs", str(tmp_path)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("optimum-distilled")]
    assert line.endswith("within") and "90 s" in line and "(5)" in line


def test_a_run_that_fails_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reproduce, "train_all", lambda jobs, *_: [Outcome(job, "failed", "lost") for job in jobs])
    assert reproduce.main(["direct-ppo", "--runs", str(tmp_path)]) == 1
    assert "direct-ppo/seed-100 failed: lost" in capsys.readouterr().err


def test_bad_options_are_named(capsys):
    for words, message in ((["nope"], "got 'nope'"), (["--seed", "5e9"], "--seed"), (["--jobs", "0"], "--jobs")):
        with pytest.raises(SystemExit):
            reproduce.main(words)
        assert message in capsys.readouterr().err
