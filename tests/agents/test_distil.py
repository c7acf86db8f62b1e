"""The optimum as a teacher: what torques cost, and runs that are the same again, stop, and are published."""

from __future__ import annotations

import dataclasses
import json
import os
import signal

import numpy as np
import pytest
import torch

from agents.distil import __main__ as command
from agents.distil import outcome, run
from agents.distil.lessons import Classroom, regrets_of
from agents.distil.network import Fit, Network, interpolated
from agents.distil.students import STUDENTS, Budget
from agents.training.presets import RunError
from agents.training.signals import INTERRUPTED
from baselines.dynamic_programming.policy import FAILURE_SCORE, NUM_TORQUES, TORQUES
from capsule_gym import load_policy
from capsule_gym.task import CONTROL_DT

TINY = Budget(num_envs=3, steps=30, updates=3, last_updates=4, parts=2, batch_size=16, learning_rate=1e-3, episodes=2)
NAME = "optimum-distilled"


def lesson_of(name: str = NAME, *, share: float = 1.0, act=None, steps: int = 60):
    classroom = Classroom(STUDENTS[name], 4, np.random.default_rng(0))
    return classroom.lesson(steps, share, act, lambda: False)


@pytest.fixture(autouse=True)
def cheap_rivals(monkeypatch):
    monkeypatch.setitem(STUDENTS, NAME, dataclasses.replace(STUDENTS[NAME], rivals=("zero",)))


@pytest.fixture(scope="module")
def lesson():
    return lesson_of()


def distil(folder, *words: str) -> int:
    return command.main([*words, "--seeds", "0", "--runs", str(folder)], budget=TINY, count=1)


def test_a_torque_costs_what_the_best_is_worth_more():
    scores = np.zeros((3, NUM_TORQUES))
    scores[0] = -((np.arange(NUM_TORQUES) - 7.0) ** 2)
    scores[1, 5:] = FAILURE_SCORE
    scores[2] = FAILURE_SCORE
    regrets = regrets_of(scores, 5.0)
    assert regrets.dtype == np.float32
    assert regrets[0, 7] == 0.0 and regrets[0, 8] == 1.0 and regrets[0, -1] == 5.0
    assert (regrets[1, :5] == 0.0).all() and (regrets[1, 5:] == 5.0).all()
    # Where nothing helps any more nothing is learnt.
    assert (regrets[2] == 0.0).all()


def test_the_teachers_own_torques_cost_nothing(lesson):
    assert len(lesson.inputs) == len(lesson.regrets)
    torques = torch.from_numpy(TORQUES[lesson.regrets.argmin(axis=1)])
    assert interpolated(torch.from_numpy(lesson.regrets), torques).max() < 1e-6 < 0.1 < lesson.regrets.max()


def test_the_cost_is_linear_between_the_torques_that_were_tried():
    regrets = torch.arange(NUM_TORQUES, dtype=torch.float32).square().repeat(3, 1)
    spacing = 2.0 / (NUM_TORQUES - 1)
    torques = torch.tensor([-1.0, -1.0 + 2.25 * spacing, 1.0], requires_grad=True)
    costs = interpolated(regrets, torques)
    assert costs.tolist() == pytest.approx([0.0, 4.0 + 0.25 * 5.0, (NUM_TORQUES - 1.0) ** 2], rel=1e-4)
    costs.sum().backward()
    assert (spacing * torques.grad).tolist() == pytest.approx([1.0, 5.0, 2.0 * NUM_TORQUES - 3.0], rel=1e-4)


def test_a_student_sees_the_plant_only_where_it_is_told(lesson):
    assert lesson.inputs.shape[1] == 5
    told = lesson_of("optimum-distilled-told", steps=3)
    assert told.inputs.shape[1] == 7
    # Drawn for every episode.
    assert len(np.unique(told.inputs[:, -1])) == 4


def test_a_student_that_identifies_is_given_what_the_filter_finds():
    name = "optimum-distilled-wide"
    assert STUDENTS[name].jump_rate > 0.0
    taught = lesson_of(name, steps=150)
    assert taught.inputs.shape[1] == 9
    first, last = taught.inputs[:4], taught.inputs[-4:]
    assert (first[:, 5:] == first[0, 5:]).all()
    assert (last[:, 7] < 0.2 * first[:, 7]).all()
    policy = Network(taught, 0).policy(name, STUDENTS[name], 0, "none")
    # What the policy makes of its observations is what its network makes of these inputs.
    act = policy.start(range(4))
    for n in range(0, len(taught.inputs), 4):
        inputs = taught.inputs[n : n + 4]
        given = np.clip((inputs - policy.mean) / np.sqrt(policy.variance + policy.epsilon), -policy.clip, policy.clip)
        for weights, bias in policy.layers:
            given = np.tanh(given @ weights.T.astype(np.float64) + bias)
        np.testing.assert_allclose(act(inputs[:, :5]), given, atol=1e-6)


def test_who_leads_decides_where_it_goes(lesson):
    seen = []

    def act(observations):
        seen.append(observations.shape)
        return np.zeros((len(observations), 1), np.float32)

    alone = lesson_of(share=0.0, act=act)
    assert set(seen) == {(4, 5)}
    assert np.abs(alone.inputs[:, 4]).mean() < 0.1 < np.abs(lesson.inputs[:, 4]).mean()


def test_a_fit_makes_the_torques_cheaper_and_the_file_acts_as_the_network_does(lesson, tmp_path):
    network, rng, costs = Network(lesson, 0), np.random.default_rng(0), []
    network.fit([lesson], Fit(150, 3e-3, 3e-3, 128), rng, lambda cost: costs.append(cost) is None)
    assert len(costs) == 150
    assert np.mean(costs[-20:]) < 0.5 * np.mean(costs[:5])
    policy = network.policy("student", STUDENTS[NAME], 0, "none")
    policy.save(tmp_path / "policy.safetensors")
    actions = load_policy(tmp_path)(lesson.inputs)
    assert actions.tobytes() == policy(lesson.inputs).tobytes()
    cost = interpolated(torch.from_numpy(lesson.regrets), torch.from_numpy(actions[:, 0])).mean().item() / CONTROL_DT
    assert cost == pytest.approx(np.mean(costs[-20:]), rel=0.3)


def test_a_fit_ends_where_it_is_told_to(lesson):
    told = []
    Network(lesson, 0).fit([lesson], Fit(50, 1e-3, 1e-3, 8), np.random.default_rng(0), lambda cost: told.append(cost))
    assert len(told) == 1


def test_the_same_seed_gives_the_same_policy_and_a_finished_run_is_kept(tmp_path, capsys):
    assert distil(tmp_path / "a") == distil(tmp_path / "b") == 0
    files = [tmp_path / name / NAME / "seed-0" / "policy.safetensors" for name in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert load_policy(files[0]).training_seed == 0
    assert command.main(["--seeds", "1", "--runs", str(tmp_path / "a")], budget=TINY, count=1) == 0
    assert (tmp_path / "a" / NAME / "seed-1" / "policy.safetensors").read_bytes() != files[0].read_bytes()
    before = files[0].stat().st_mtime_ns
    capsys.readouterr()
    assert distil(tmp_path / "a") == 0
    assert files[0].stat().st_mtime_ns == before
    shown = capsys.readouterr().out
    lines = {line.split()[0]: line.split()[1] for line in shown.splitlines() if line.startswith((NAME, "zero"))}
    assert lines == {NAME: "1", "zero": "1"}


def test_ctrl_c_keeps_the_best_policy_and_nothing_writes_over_it(tmp_path, monkeypatch, capsys):
    judged = []

    def judge(policy, draws):
        judged.append(policy)
        if len(judged) == 2:
            os.kill(os.getpid(), signal.SIGINT)
        return float(-len(judged)), 0.0

    monkeypatch.setattr(run, "judge", judge)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert distil(tmp_path) == INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(judged) == 2
    folder = tmp_path / NAME / "seed-0"
    assert [path.name for path in folder.iterdir()] == ["policy.safetensors"]
    observations = np.zeros((1, 5), np.float32)
    assert load_policy(folder)(observations).tobytes() == judged[0](observations).tobytes()
    assert "kept" in capsys.readouterr().out
    with pytest.raises(SystemExit) as refused:
        distil(tmp_path)
    assert refused.value.code == 2
    assert "was begun and is not finished" in capsys.readouterr().err


def test_only_what_can_be_checked_out_is_published(tmp_path):
    folder, checkpoints = tmp_path / "run", tmp_path / "checkpoints"
    folder.mkdir()
    (folder / "policy.safetensors").write_bytes(b"policy")
    result = {"mean_speed": 20.0, "failed": 0.0, "core_seconds": 1.0, "revision": "0123456789ab+"}
    (folder / "finished.json").write_text(json.dumps(result))
    with pytest.raises(RunError, match="nothing uncommitted"):
        outcome.publish(NAME, {3: folder}, checkpoints)
    assert not checkpoints.exists()
    (folder / "finished.json").write_text(json.dumps({**result, "revision": "0123456789ab"}))
    outcome.publish(NAME, {3: folder}, checkpoints)
    assert (checkpoints / NAME / "seed-3" / "policy.safetensors").read_bytes() == b"policy"


@pytest.mark.parametrize("words", [["another"], ["--seeds", "x"]])
def test_what_does_not_exist_is_refused_in_a_line(words, capsys):
    with pytest.raises(SystemExit) as refused:
        command.main(words)
    assert refused.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and words[-1] in error
