import dataclasses
import json
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from agents.distillation import __main__ as command
from agents.distillation import dagger
from agents.distillation.config import STUDENTS
from agents.distillation.dagger import Network, interpolated_regret
from agents.distillation.dataset import collect
from agents.training.signals import INTERRUPTED
from baselines.dynamic_programming.policy import NUM_TORQUES, TORQUES
from capsule_gym import load_policy
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import CONTROL_DT

NAME = "dp-distilled-wide"
SIZES = {
    "num_envs": 3,
    "steps": 30,
    "updates": 3,
    "final_updates": 4,
    "final_parts": 2,
    "batch_size": 16,
}
TINY = dataclasses.replace(STUDENTS[NAME], **SIZES, learning_rate=1e-3, evaluation_episodes=2)


def collected(*, expert_share=1.0, act=None, steps=60, **settings):
    student = dataclasses.replace(STUDENTS[NAME], num_envs=4, steps=steps, **settings)
    return collect(student, np.random.default_rng(0), expert_share, act)


@pytest.fixture(scope="module")
def dataset():
    return collected()


def test_the_loss_is_linear_between_the_torques_of_the_expert(dataset):
    regrets = torch.arange(NUM_TORQUES, dtype=torch.float32).square().repeat(3, 1)
    spacing = 2.0 / (NUM_TORQUES - 1)
    torques = torch.tensor([-1.0, -1.0 + 2.25 * spacing, 1.0], requires_grad=True)
    costs = interpolated_regret(regrets, torques)
    assert costs.tolist() == pytest.approx(
        [0.0, 4.0 + 0.25 * 5.0, (NUM_TORQUES - 1.0) ** 2], rel=1e-4
    )
    costs.sum().backward()
    assert (spacing * torques.grad).tolist() == pytest.approx(
        [1.0, 5.0, 2.0 * NUM_TORQUES - 3.0], rel=1e-4
    )
    # The expert's own torques have no regret.
    best = torch.from_numpy(TORQUES[dataset.regrets.argmin(axis=1)])
    assert (
        interpolated_regret(torch.from_numpy(dataset.regrets), best).max()
        < 1e-6
        < 0.1
        < dataset.regrets.max()
    )


def test_the_expert_acts_less_and_less_and_the_step_size_falls_to_zero():
    student = STUDENTS[NAME]
    shares, updates, rates = zip(*dagger.schedule(student), strict=True)
    rounds, final = list(shares[: student.rounds]), rates[student.rounds :]
    assert (rounds[0], rounds[-1]) == (1.0, 0.0) and rounds == sorted(rounds, reverse=True)
    assert sum(updates) == student.rounds * student.updates + student.final_updates
    assert rates[0][0] == final[0][0] == student.learning_rate and all(
        high > low for high, low in rates
    )
    assert [high for high, _ in final[1:]] + [0.0] == pytest.approx([low for _, low in final])


def test_a_student_observes_the_estimates():
    assert STUDENTS[NAME].change_rate > 0.0
    data = collected(steps=150)
    first, last = data.inputs[:4], data.inputs[-4:]
    assert (first[:, 5:] == first[0, 5:]).all() and (last[:, 7] < 0.2 * first[:, 7]).all()
    policy = Network(data, 0).policy(NAME, STUDENTS[NAME], 0, "none")
    given = np.clip(
        (data.inputs - policy.mean) / np.sqrt(policy.variance + policy.epsilon),
        -policy.clip,
        policy.clip,
    )
    for weights, bias in policy.layers:
        given = np.tanh(given @ weights.T.astype(np.float64) + bias)
    np.testing.assert_allclose(policy(data.inputs), given, atol=1e-6)


def test_a_torque_that_leaves_less_normal_force_than_the_margin_costs_more():
    def regrets(**settings):
        plain = {"steps": 1, "max_regret": 100.0, "deviations": 0.0}
        return collected(**(plain | settings)).regrets

    small, large = regrets(margin=1.0), regrets(margin=20.0)
    assert large.mean() > small.mean() + 10.0
    # Before any observation, the standard deviation of M is that of the prior, 0.2 kg.
    uncertain = regrets(margin=1.0, deviations=2.0)
    np.testing.assert_allclose(
        uncertain, regrets(margin=1.0 + 2.0 * NOMINAL.g * 0.2), rtol=1e-4, atol=1e-4
    )
    assert (uncertain != small).any()


def test_the_acting_policy_decides_the_states(dataset):
    shapes = []

    def zero(observations):
        shapes.append(observations.shape)
        return np.zeros((len(observations), 1), np.float32)

    alone = collected(expert_share=0.0, act=zero)
    assert (
        set(shapes) == {(4, 9)}
        and np.abs(alone.inputs[:, 4]).mean() < 0.1 < np.abs(dataset.inputs[:, 4]).mean()
    )


def test_a_fit_lowers_the_loss_and_the_file_acts_as_the_network(dataset, tmp_path):
    network, rng = Network(dataset, 0), np.random.default_rng(0)
    losses = network.fit([dataset], 150, (3e-3, 0.0), 128, rng)
    assert len(losses) == 150 and np.mean(losses[-20:]) < 0.5 * np.mean(losses[:5])
    policy = network.policy("student", STUDENTS[NAME], 0, "none")
    policy.save(tmp_path / "policy.safetensors")
    actions, again = (each(dataset.inputs) for each in (load_policy(tmp_path), policy))
    assert actions.tobytes() == again.tobytes()
    regrets = interpolated_regret(
        torch.from_numpy(dataset.regrets), torch.from_numpy(actions[:, 0])
    )
    assert regrets.mean().item() / CONTROL_DT == pytest.approx(np.mean(losses[-20:]), rel=0.3)


def test_the_same_seed_gives_the_same_policy_and_finished_runs_are_skipped(tmp_path, monkeypatch):
    monkeypatch.setitem(STUDENTS, NAME, TINY)
    torch.set_num_threads(2)
    for folder in "ab":
        assert command.main([NAME, "--seeds", "0", "--runs", str(tmp_path / folder)]) == 0
    assert torch.get_num_threads() == 1
    files = [tmp_path / name / NAME / "seed-0" / "policy.safetensors" for name in "ab"]
    assert (
        files[0].read_bytes() == files[1].read_bytes() and load_policy(files[0]).training_seed == 0
    )
    before = files[0].stat().st_mtime_ns
    assert command.main([NAME, "--seeds", "0", "1", "--runs", str(tmp_path / "a")]) == 0
    assert files[0].stat().st_mtime_ns == before
    assert (tmp_path / "a" / NAME / "seed-1" / "policy.safetensors").read_bytes() != files[
        0
    ].read_bytes()


def test_the_failure_cost_decides_which_policy_is_kept(tmp_path, monkeypatch):
    evaluations = [{"mean_speed": 5.0, "failed": 0.1}, *[{"mean_speed": 6.0, "failed": 0.3}] * 3]
    for cost, kept in (4.0, 6.0), (6.0, 5.0):
        monkeypatch.setattr(dagger, "evaluate", Mock(side_effect=[[each] for each in evaluations]))
        monkeypatch.setitem(STUDENTS, NAME, dataclasses.replace(TINY, rounds=2, failure_cost=cost))
        assert command.main([NAME, "--seeds", "0", "--runs", str(tmp_path / str(cost))]) == 0
        assert (
            json.loads((tmp_path / str(cost) / NAME / "seed-0" / dagger.FINISHED).read_text())[
                "mean_speed"
            ]
            == kept
        )


def test_ctrl_c_keeps_the_best_policy_and_the_run_is_not_overwritten(
    tmp_path, monkeypatch, capsys, refused
):
    evaluate = Mock(side_effect=[[{"mean_speed": -1.0, "failed": 0.0}], KeyboardInterrupt])
    monkeypatch.setattr(dagger, "evaluate", evaluate)
    monkeypatch.setitem(STUDENTS, NAME, TINY)
    words = [NAME, "--seeds", "0", "--runs", str(tmp_path)]
    assert command.main(words) == INTERRUPTED and evaluate.call_count == 2
    folder, evaluated = tmp_path / NAME / "seed-0", evaluate.call_args_list[0].args[0]
    assert sorted(path.name for path in folder.iterdir()) == ["config.json", "policy.safetensors"]
    record = json.loads((folder / "config.json").read_text())
    assert record["hyperparameters"] == json.loads(json.dumps(dataclasses.asdict(STUDENTS[NAME])))
    assert record["revision"] == load_policy(folder).revision
    kept, first = (
        policy(np.zeros((1, 9), np.float32)) for policy in (load_policy(folder), evaluated)
    )
    assert kept.tobytes() == first.tobytes() and "kept" in capsys.readouterr().out
    assert "is an unfinished run" in refused(command.main, words)
