"""What may stand on the leaderboard: finished runs of the row's settings, of a revision that can be checked out."""

import dataclasses
import json

import pytest

from agents.study.jobs import FINISHED
from agents.study.publication import publish
from agents.training.errors import RunError
from tests.agents.fakes import write_run
from tests.agents.study.small import job


@pytest.fixture
def finished(tmp_path):
    made = job(tmp_path / "runs", seed=3)
    write_run(made.run / "best", 3)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": made.config.to_dict(), "revision": "0123456789ab"}
    (made.run / "config.json").write_text(json.dumps(content))
    (made.run / "evaluations.csv").write_text("steps,seconds\n")
    (made.run / FINISHED).write_text("{}")
    return made


def test_the_best_policy_and_the_evaluations_are_copied(finished, tmp_path):
    checkpoints = tmp_path / "checkpoints"
    folder = publish(finished, checkpoints)
    assert folder == checkpoints / "tiny" / "seed-3"
    assert sorted(path.name for path in folder.iterdir()) == ["evaluations.csv", "policy.safetensors"]
    policy = (finished.run / "best" / "policy.safetensors").read_bytes()
    assert (folder / "policy.safetensors").read_bytes() == policy
    # Again, over what is there.
    (folder / "policy.safetensors").write_bytes(b"")
    publish(finished, checkpoints)
    assert (folder / "policy.safetensors").read_bytes() == policy


@pytest.mark.parametrize("revision", ["0123456789ab+", "unknown"])
def test_a_revision_that_nobody_can_check_out_is_refused(finished, tmp_path, revision):
    path = finished.run / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "revision": revision}))
    with pytest.raises(RunError, match="nothing uncommitted") as error:
        publish(finished, tmp_path / "checkpoints")
    assert repr(revision) in str(error.value)
    assert not (tmp_path / "checkpoints").exists()


def test_other_settings_than_the_rows_are_refused(finished, tmp_path):
    other = dataclasses.replace(finished, config=dataclasses.replace(finished.config, gamma=0.5))
    with pytest.raises(RunError, match="gamma"):
        publish(other, tmp_path / "checkpoints")


def test_a_run_that_is_not_finished_is_refused(finished, tmp_path):
    (finished.run / FINISHED).unlink()
    with pytest.raises(RunError, match="not finished"):
        publish(finished, tmp_path / "checkpoints")
