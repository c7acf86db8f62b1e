import dataclasses
import json
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from agents.distillation import __main__ as command
from agents.distillation import dagger
from agents.distillation import dataset as data
from agents.distillation.config import STUDENTS
from agents.distillation.dagger import Network, interpolated_regret
from agents.distillation.dataset import _plant_changes, collect
from agents.training.signals import INTERRUPTED
from baselines.dynamic_programming.policy import NUM_TORQUES, TORQUES
from capsule_gym import load_policy
from capsule_gym.parameters import NOMINAL
from capsule_gym.policies.policy import POLICY
from capsule_gym.tasks.task import CONTROL_DT

NAME = "dp-distilled-wide"
STUDENT = STUDENTS[NAME]
TINY = dataclasses.replace(
    STUDENT,
    num_envs=3,
    steps=30,
    updates=3,
    final_updates=4,
    final_parts=2,
    batch_size=16,
    learning_rate=1e-3,
    evaluation_episodes=2,
)
# Columns of the student's observation: the last action; the estimates of M and the logarithm of mu,
# and their standard deviations.
LAST_ACTION = 4
ESTIMATES = slice(5, 9)
M_DEVIATION = 7


def collected(*, expert_share=1.0, act=None, steps=60, **settings):
    student = dataclasses.replace(STUDENT, num_envs=4, steps=steps, **settings)
    return collect(student, np.random.default_rng(0), expert_share, act)


@pytest.fixture(scope="module")
def dataset():
    return collected()


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setitem(STUDENTS, NAME, TINY)


def arguments(runs, *seeds):
    return [NAME, "--seeds", *map(str, seeds), "--runs", str(runs)]


def distilled(runs, *seeds):
    """Distils on the command line; returns the folders of the runs."""
    assert command.main(arguments(runs, *seeds)) == 0
    return [runs / NAME / f"seed-{seed}" for seed in seeds]


def test_the_loss_is_linear_between_the_torques_of_the_expert():
    regrets = torch.arange(NUM_TORQUES, dtype=torch.float32).square().repeat(3, 1)
    last = NUM_TORQUES - 1.0
    spacing = 2.0 / last
    torques = torch.tensor([-1.0, -1.0 + 2.25 * spacing, 1.0], requires_grad=True)
    costs = interpolated_regret(regrets, torques)
    assert costs.tolist() == pytest.approx([0.0, 4.0 + 0.25 * 5.0, last**2], rel=1e-4)
    costs.sum().backward()
    slopes = spacing * torques.grad
    assert slopes.tolist() == pytest.approx([1.0, 5.0, 2.0 * last - 1.0], rel=1e-4)


def test_the_torques_of_the_expert_have_no_regret(dataset):
    best = torch.from_numpy(TORQUES[dataset.regrets.argmin(axis=1)])
    losses = interpolated_regret(torch.from_numpy(dataset.regrets), best)
    assert losses.max() < 1e-6
    assert dataset.regrets.max() > 0.1


def test_the_expert_acts_less_and_less():
    shares = [share for share, _, _ in dagger.schedule(STUDENT)]
    rounds = shares[: STUDENT.rounds]
    assert rounds[0] == 1.0
    assert rounds[-1] == 0.0
    assert rounds == sorted(rounds, reverse=True)


def test_the_schedule_has_all_updates():
    updates = [count for _, count, _ in dagger.schedule(STUDENT)]
    assert sum(updates) == STUDENT.rounds * STUDENT.updates + STUDENT.final_updates


def test_the_step_size_falls_to_zero():
    rates = [each for _, _, each in dagger.schedule(STUDENT)]
    final = rates[STUDENT.rounds :]
    assert rates[0][0] == STUDENT.learning_rate
    assert final[0][0] == STUDENT.learning_rate
    assert all(first > last for first, last in rates)
    next_firsts = [first for first, _ in final[1:]]
    assert [last for _, last in final] == pytest.approx([*next_firsts, 0.0])


def test_a_student_observes_the_estimates():
    assert STUDENT.change_rate > 0.0
    inputs = collected(steps=150).inputs
    first, last = inputs[:4], inputs[-4:]
    assert (first[:, ESTIMATES] == first[0, ESTIMATES]).all()
    assert (last[:, M_DEVIATION] < 0.2 * first[:, M_DEVIATION]).all()


def test_plants_change_at_the_rate_of_the_student_within_an_episode():
    student = dataclasses.replace(STUDENT, num_envs=200)
    seconds = student.steps * CONTROL_DT
    changes = _plant_changes(student, np.random.default_rng(0))["changes"]
    times = np.concatenate([[change["t"] for change in episode] for episode in changes])
    assert times.max() < seconds
    assert len(times) / len(changes) == pytest.approx(student.change_rate * seconds, rel=0.1)


def test_a_policy_is_the_network_of_normalised_inputs(dataset):
    policy = Network(dataset, 0).policy(NAME, STUDENT, 0, "none")
    scaled = (dataset.inputs - policy.mean) / np.sqrt(policy.variance + policy.epsilon)
    values = np.clip(scaled, -policy.clip, policy.clip)
    for weights, bias in policy.layers:
        values = np.tanh(values @ weights.T.astype(np.float64) + bias)
    np.testing.assert_allclose(policy(dataset.inputs), values, atol=1e-6)


def first_regrets(margin, deviations=0.0):
    return collected(steps=1, max_regret=100.0, margin=margin, deviations=deviations).regrets


def test_a_torque_that_leaves_less_normal_force_than_the_margin_costs_more():
    assert first_regrets(20.0).mean() > first_regrets(1.0).mean() + 10.0


def test_an_uncertain_mass_enlarges_the_margin():
    # Before any observation, the standard deviation of M is that of the prior, 0.2 kg.
    expected = first_regrets(1.0 + 2.0 * NOMINAL.g * 0.2)
    uncertain = first_regrets(1.0, deviations=2.0)
    np.testing.assert_allclose(uncertain, expected, rtol=1e-4, atol=1e-4)
    assert (uncertain != first_regrets(1.0)).any()


def test_the_acting_policy_decides_the_states(dataset):
    shapes = set()

    def zero(observations):
        shapes.add(observations.shape)
        return np.zeros((len(observations), 1), np.float32)

    alone = collected(expert_share=0.0, act=zero)
    assert shapes == {(4, 9)}
    assert np.abs(alone.inputs[:, LAST_ACTION]).mean() < 0.1
    assert np.abs(dataset.inputs[:, LAST_ACTION]).mean() > 0.1


def test_random_actions_cover_their_range(monkeypatch):
    monkeypatch.setattr(data, "EXPLORATION_PROBABILITY", 1.0)
    # The first action of every episode follows its first observation.
    actions = collected().inputs[4:, LAST_ACTION]
    lowest, middle, highest = np.quantile(actions, [0.02, 0.5, 0.98])
    assert -1.0 < lowest < -0.85
    assert abs(middle) < 0.3
    assert 0.85 < highest < 1.0


@pytest.fixture(scope="module")
def fitted(dataset):
    """A network after a fit, and the losses of the fit."""
    network = Network(dataset, 0)
    rng = np.random.default_rng(0)
    return network, network.fit([dataset], 150, (3e-3, 0.0), 128, rng)


def test_a_fit_lowers_the_loss(fitted):
    _, losses = fitted
    assert len(losses) == 150
    assert np.mean(losses[-20:]) < 0.5 * np.mean(losses[:5])


def test_a_policy_file_acts_as_the_network(fitted, dataset, tmp_path):
    network, losses = fitted
    policy = network.policy("student", STUDENT, 0, "none")
    policy.save(tmp_path / POLICY)
    actions = load_policy(tmp_path)(dataset.inputs)
    assert actions.tobytes() == policy(dataset.inputs).tobytes()
    regrets = interpolated_regret(
        torch.from_numpy(dataset.regrets), torch.from_numpy(actions[:, 0])
    )
    assert regrets.mean().item() / CONTROL_DT == pytest.approx(np.mean(losses[-20:]), rel=0.3)


def test_the_same_seed_gives_the_same_policy(tmp_path, tiny):
    # Sums of several threads have other bits.
    torch.set_num_threads(2)
    (run,) = distilled(tmp_path / "first", 0)
    (again,) = distilled(tmp_path / "second", 0)
    assert torch.get_num_threads() == 1
    assert (run / POLICY).read_bytes() == (again / POLICY).read_bytes()
    assert load_policy(run).training_seed == 0


def test_finished_runs_are_skipped(tmp_path, tiny):
    (finished,) = distilled(tmp_path, 0)
    before = (finished / POLICY).stat().st_mtime_ns
    _, other = distilled(tmp_path, 0, 1)
    assert (finished / POLICY).stat().st_mtime_ns == before
    assert (other / POLICY).read_bytes() != (finished / POLICY).read_bytes()


@pytest.mark.parametrize(("failure_cost", "kept"), [(4.0, 6.0), (6.0, 5.0)])
def test_the_failure_cost_decides_which_policy_is_kept(tmp_path, monkeypatch, failure_cost, kept):
    slow = {"mean_speed": 5.0, "failed": 0.1}
    fast = {"mean_speed": 6.0, "failed": 0.3}
    monkeypatch.setattr(dagger, "evaluate", Mock(side_effect=[[slow], [fast], [fast], [fast]]))
    student = dataclasses.replace(TINY, rounds=2, failure_cost=failure_cost)
    monkeypatch.setitem(STUDENTS, NAME, student)
    (run,) = distilled(tmp_path, 0)
    assert json.loads((run / dagger.FINISHED).read_text())["mean_speed"] == kept


@pytest.fixture
def interrupted(tmp_path, monkeypatch, tiny):
    """A run that Ctrl-C stopped in its second evaluation, and the policy of the first one."""
    evaluate = Mock(side_effect=[[{"mean_speed": -1.0, "failed": 0.0}], KeyboardInterrupt])
    monkeypatch.setattr(dagger, "evaluate", evaluate)
    assert command.main(arguments(tmp_path, 0)) == INTERRUPTED
    assert evaluate.call_count == 2
    return tmp_path / NAME / "seed-0", evaluate.call_args_list[0].args[0]


def test_ctrl_c_keeps_the_best_policy(capsys, interrupted):
    run, evaluated = interrupted
    assert "kept" in capsys.readouterr().out
    assert sorted(path.name for path in run.iterdir()) == ["config.json", "policy.safetensors"]
    observation = np.zeros((1, 9), np.float32)
    assert load_policy(run)(observation).tobytes() == evaluated(observation).tobytes()


def test_a_run_records_its_student_and_its_revision(interrupted):
    run, _ = interrupted
    record = json.loads((run / "config.json").read_text())
    assert record["hyperparameters"] == json.loads(json.dumps(dataclasses.asdict(TINY)))
    assert record["revision"] == load_policy(run).revision


def test_an_unfinished_run_is_not_overwritten(interrupted, tmp_path, refused):
    assert "is an unfinished run" in refused(command.main, arguments(tmp_path, 0))
