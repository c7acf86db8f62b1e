"""The plan of a study: which runs, in which order, and what is refused."""

import dataclasses
import json

import pytest

from agents.study.jobs import Evaluation, evaluations, plan, seeds_of
from agents.training.errors import RunError
from agents.training.presets import ROWS


def test_ranges_of_seeds_are_read_in_order_and_once():
    assert seeds_of(["7", "0-2", "1-3"]) == [0, 1, 2, 3, 7]


@pytest.mark.parametrize("word", ["", "x", "-1", "3-1", "0,1", "1.5", "4294967296"])
def test_what_is_no_seed_is_named(word):
    with pytest.raises(ValueError, match="--seeds must be") as error:
        seeds_of([word])
    assert repr(word) in str(error.value)


def test_a_plan_holds_every_row_with_every_seed_first_seeds_first(tmp_path):
    jobs = plan(["direct-ppo", "direct-sac"], [0, 4], tmp_path)
    assert [job.name for job in jobs] == [
        "direct-ppo/seed-0",
        "direct-sac/seed-0",
        "direct-ppo/seed-4",
        "direct-sac/seed-4",
    ]
    assert jobs[3].config == dataclasses.replace(ROWS["direct-sac"], seed=4)
    assert jobs[3].run == tmp_path / "direct-sac" / "seed-4"
    assert not any(job.finished for job in jobs)
    with pytest.raises(ValueError, match="nope"):
        plan(["nope"], [0], tmp_path)


def test_a_run_of_other_settings_is_not_gone_on_with(tmp_path):
    run = tmp_path / "direct-ppo" / "seed-0"
    run.mkdir(parents=True)
    config = dataclasses.replace(ROWS["direct-ppo"], gamma=0.5)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": config.to_dict()}
    (run / "config.json").write_text(json.dumps(content))
    with pytest.raises(RunError, match=r"gamma was 0\.5 and is 0\.995"):
        plan(["direct-ppo"], [0], tmp_path)
    assert len(plan(["direct-ppo"], [1], tmp_path)) == 1


def test_evaluations_are_those_that_are_whole(tmp_path):
    assert evaluations(tmp_path) == []
    lines = ["steps,seconds,mean_speed_cm_s,failed,baseline_mean_speed_cm_s", "100,1.5,12.0,0.1,1.4", "200,3.0,13"]
    (tmp_path / "evaluations.csv").write_text("\n".join(lines))
    assert evaluations(tmp_path) == [Evaluation(100, 1.5, 12.0, 0.1)]
    assert evaluations(tmp_path)[0].score == pytest.approx(9.0)
