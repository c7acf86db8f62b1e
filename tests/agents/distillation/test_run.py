import dataclasses
import itertools
import json
import pickle
import shutil
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from agents import information
from agents.distillation import __main__ as command
from agents.distillation import dagger
from agents.distillation.config import STUDENTS
from agents.training.signals import INTERRUPTED
from capsule_gym import load_policy
from capsule_gym.parameters import RANDOMIZATIONS
from capsule_gym.policies.policy import POLICY
from tests.agents.distillation.conftest import RECURRENT

NAME = "dp-distilled"
STUDENT = STUDENTS[NAME]


@pytest.fixture
def runs(tmp_path, monkeypatch, plants_folder):
    """A folder of runs with the solved plants of a tiny student, which is that of `NAME`."""
    monkeypatch.setitem(STUDENTS, NAME, RECURRENT)

    def make(name):
        folder = tmp_path / name
        shutil.copytree(plants_folder, folder / NAME / "plants")
        return folder

    return make


def arguments(folder, *seeds):
    return [NAME, "--seeds", *map(str, seeds), "--runs", str(folder)]


def distilled(folder, *seeds):
    """Distils on the command line; returns the folders of the runs."""
    assert command.main(arguments(folder, *seeds)) == 0
    return [folder / NAME / f"seed-{seed}" for seed in seeds]


def test_the_expert_acts_less_and_less():
    shares = [fit.expert_share for fit in dagger.schedule(STUDENT)]
    rounds = shares[: STUDENT.rounds]
    assert rounds[0] == 1.0
    assert rounds[-1] == 0.0
    assert rounds == sorted(rounds, reverse=True)


def test_the_schedule_has_all_updates():
    updates = [fit.updates for fit in dagger.schedule(STUDENT)]
    assert sum(updates) == STUDENT.rounds * STUDENT.updates + STUDENT.final_updates


def test_the_step_size_falls_to_zero():
    rates = [fit.rates for fit in dagger.schedule(STUDENT)]
    final = rates[STUDENT.rounds :]
    assert rates[0] == pytest.approx((STUDENT.learning_rate, 0.3 * STUDENT.learning_rate))
    assert final[0][0] == 0.5 * STUDENT.learning_rate
    assert all(first > last for first, last in rates)
    next_firsts = [first for first, _ in final[1:]]
    assert [last for _, last in final] == pytest.approx([*next_firsts, 0.0])


def test_the_same_seed_gives_the_same_policy(runs):
    # Sums of several threads have other bits.
    torch.set_num_threads(2)
    (run,) = distilled(runs("first"), 0)
    (again,) = distilled(runs("second"), 0)
    assert torch.get_num_threads() == 1
    assert (run / POLICY).read_bytes() == (again / POLICY).read_bytes()
    assert load_policy(run).training_seed == 0


def test_a_cell_of_the_table_of_information_is_distilled(tmp_path, monkeypatch, plants_folder):
    monkeypatch.setattr(information, "evaluate", partial(information.evaluate, horizon=0.1))
    shutil.copytree(plants_folder, tmp_path / "paper" / "plants")
    found = information.train_cell(information.Cell("paper", "tiny", RECURRENT), (3,), tmp_path, 1)
    run = tmp_path / "paper" / "tiny-3"
    assert load_policy(run).training_seed == 3
    finished = json.loads((run / dagger.FINISHED).read_text())
    assert found["core_seconds"] == [finished["core_seconds"]]
    assert found["mean_speed"].shape == (1, 400)


def test_finished_runs_are_skipped(runs):
    folder = runs("runs")
    (finished,) = distilled(folder, 0)
    before = (finished / POLICY).stat().st_mtime_ns
    _, other = distilled(folder, 0, 1)
    assert (finished / POLICY).stat().st_mtime_ns == before
    assert (other / POLICY).read_bytes() != (finished / POLICY).read_bytes()


def test_a_finished_run_keeps_no_data(runs):
    (run,) = distilled(runs("runs"), 0)
    found = sorted(path.name for path in run.iterdir())
    assert found == ["config.json", "finished.json", "policy.safetensors"]


@pytest.mark.parametrize(("failure_cost", "kept"), [(4.0, 6.0), (6.0, 5.0)])
def test_the_failure_cost_decides_which_policy_is_kept(runs, monkeypatch, failure_cost, kept):
    slow = [{"mean_speed": 4.0, "failed": 0.1}, {"mean_speed": 6.0, "failed": 0.1}]
    fast = [{"mean_speed": 6.0, "failed": 0.2}, {"mean_speed": 6.0, "failed": 0.4}]
    evaluate = Mock(side_effect=[slow, fast, fast, fast])
    monkeypatch.setattr(dagger, "evaluate", evaluate)
    student = dataclasses.replace(RECURRENT, rounds=2, failure_cost=failure_cost)
    monkeypatch.setitem(STUDENTS, NAME, student)
    (run,) = distilled(runs("runs"), 0)
    assert json.loads((run / dagger.FINISHED).read_text())["mean_speed"] == kept
    assert evaluate.call_count == 4
    low, high = RANDOMIZATIONS["paper"].M
    for call in evaluate.call_args_list:
        _, selection = call.args
        assert all(low <= plant.M <= high for plant in selection.plants)


@pytest.fixture
def interrupted(runs, monkeypatch):
    """A folder with a run that Ctrl-C stopped in its second evaluation, and its first policy."""
    folder = runs("runs")
    with monkeypatch.context() as patch:
        evaluate = Mock(side_effect=[[{"mean_speed": -1.0, "failed": 0.0}], KeyboardInterrupt])
        patch.setattr(dagger, "evaluate", evaluate)
        assert command.main(arguments(folder, 0)) == INTERRUPTED
    assert evaluate.call_count == 2
    return folder, evaluate.call_args_list[0].args[0]


def test_ctrl_c_keeps_the_best_policy(capsys, interrupted):
    folder, evaluated = interrupted
    assert "continues" in capsys.readouterr().out
    observation = np.zeros((1, 5), np.float32)
    kept = load_policy(folder / NAME / "seed-0").start([0])(observation)
    assert kept.tobytes() == evaluated.start([0])(observation).tobytes()


def run_with(folder, monkeypatch, answers):
    """Repeats the command until the run ends, on a clock that advances by 1 s a reading.

    Returns:
        The folder of the run, and the actions of the policies that were evaluated.
    """
    evaluate = Mock(side_effect=answers)
    clock = SimpleNamespace(process_time=itertools.count().__next__)
    with monkeypatch.context() as patch:
        patch.setattr(dagger, "evaluate", evaluate)
        patch.setattr(dagger, "time", clock)
        while command.main(arguments(folder, 0)) == INTERRUPTED:
            pass
    assert evaluate.call_count == len(answers)
    observation = np.ones((1, 5), np.float32)
    policies = [call.args[0] for call in evaluate.call_args_list]
    actions = [policy.start([0])(observation).item() for policy in policies]
    return folder / NAME / "seed-0", actions


def test_an_interrupted_run_ends_as_one_that_is_not(runs, monkeypatch):
    falling = [[{"mean_speed": speed, "failed": 0.0}] for speed in (5.0, 4.0, 3.0, 2.0, 1.0)]
    first, second, *rest = falling
    stops = [first, KeyboardInterrupt, second, KeyboardInterrupt, *rest]
    whole, actions = run_with(runs("whole"), monkeypatch, falling)
    parts, repeated = run_with(runs("parts"), monkeypatch, stops)
    assert len(set(actions)) == 5
    assert [repeated[n] for n in (0, 2, 4, 5, 6)] == actions
    for name in (POLICY, dagger.FINISHED):
        assert (parts / name).read_bytes() == (whole / name).read_bytes()
    result = json.loads((parts / dagger.FINISHED).read_text())
    assert result["mean_speed"] == 5.0
    assert result["core_seconds"] == 5.0


def test_a_checkpoint_with_pickled_code_is_not_loaded(interrupted):
    folder, _ = interrupted
    torch.save(SimpleNamespace(), folder / NAME / "seed-0" / dagger.CHECKPOINT)
    with pytest.raises(pickle.UnpicklingError):
        command.main(arguments(folder, 0))


def test_a_run_of_another_student_is_not_continued(interrupted, monkeypatch, refused):
    folder, _ = interrupted
    monkeypatch.setitem(STUDENTS, NAME, dataclasses.replace(RECURRENT, margin=0.7))
    assert "move it" in refused(command.main, arguments(folder, 0))


def test_a_run_records_its_student_and_its_revision(interrupted):
    folder, _ = interrupted
    run = folder / NAME / "seed-0"
    record = json.loads((run / "config.json").read_text())
    assert record["hyperparameters"] == json.loads(json.dumps(dataclasses.asdict(RECURRENT)))
    assert record["revision"] == load_policy(run).revision
