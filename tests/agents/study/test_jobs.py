"""The plan of a study: which runs, in which order, and what is refused."""

import dataclasses
import json

import pytest

from agents.study.jobs import Evaluation, best, evaluations, plan, seeds_of
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


def line(steps: int, score: float, stage: int = 0) -> Evaluation:
    return Evaluation(steps=steps, seconds=1.5, mean_speed=12.0, failed=0.1, score=score, stage=stage)


def test_evaluations_are_those_that_are_whole(tmp_path):
    assert evaluations(tmp_path) == []
    lines = ["steps,seconds,mean_speed_cm_s,failed,score_cm_s,stage", "100,1.5,12.0,0.1,9.0,0", "200,3.0,13"]
    (tmp_path / "evaluations.csv").write_text("\n".join(lines))
    assert evaluations(tmp_path) == [line(100, 9.0)]


def test_what_a_run_has_come_to_is_the_best_of_its_last_stage():
    one = ROWS["direct-ppo"]
    two = dataclasses.replace(one, direct_steps=1)
    assert len(two.stages()) == 2
    lines = [line(100, 9.0), line(200, 12.0), line(300, 3.0, stage=1), line(400, 4.0, stage=1), line(500, 2.0, stage=1)]
    assert best(lines[:2], one) == lines[1]
    assert best(lines, two) == lines[3]
    assert best(lines[:2], two) is None
