import dataclasses

import numpy as np
import pytest
import torch

from agents.distillation.dataset import Dataset, collect
from agents.distillation.network import Network, interpolated_regret
from baselines.dynamic_programming.policy import NUM_TORQUES, TORQUES
from capsule_gym import load_policy
from capsule_gym.policies.policy import POLICY
from tests.agents.distillation.conftest import FEEDFORWARD, RECURRENT


@pytest.fixture(scope="module")
def dataset(solved):
    return collect(RECURRENT, *solved, np.random.default_rng(0), 1.0, None)


@pytest.fixture(scope="module")
def estimated(solved_nominal):
    return collect(FEEDFORWARD, *solved_nominal, np.random.default_rng(0), 1.0, None)


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


def test_the_torques_of_the_expert_have_no_loss(dataset):
    regrets = torch.from_numpy(dataset.regrets.reshape(-1, NUM_TORQUES).astype(np.float32))
    best = torch.from_numpy(TORQUES)[regrets.argmin(dim=1)]
    assert interpolated_regret(regrets, best).max() < 1e-6


@pytest.mark.parametrize("student", [FEEDFORWARD, RECURRENT])
def test_a_policy_file_acts_as_the_network(student, dataset, estimated, tmp_path):
    data = dataset if student is RECURRENT else estimated
    network = Network(student, data, 0)
    network.fit([data], 5, (1e-3, 0.0), np.random.default_rng(0))
    network.policy("student", 0, "none").save(tmp_path / POLICY)
    policy = load_policy(tmp_path)
    scaled = (data.inputs - network.mean) / np.sqrt(network.variance + policy.epsilon)
    inputs = torch.from_numpy(np.clip(scaled, -policy.clip, policy.clip).astype(np.float32))
    with torch.no_grad():
        # The first dimension is the step.
        torques = network.module(inputs.swapaxes(0, 1)).numpy()
    act = policy.start(range(student.num_envs))
    for step in range(student.steps):
        actions = act(data.inputs[:, step])
        np.testing.assert_allclose(actions, torques[step][:, None], atol=1e-5)


def test_inputs_that_count_are_normalised_and_a_constant_one_is_0():
    counted = np.random.default_rng(0).normal([0.0, 1.0, -2.0, 3.0], [1.0, 2.0, 0.5, 0.0], (25, 4))
    inputs = np.full((1, 40, 4), 1e6)
    inputs[0, :25] = counted
    running = np.arange(40)[None] < 25
    network = Network(FEEDFORWARD, Dataset(inputs, np.zeros(0), running), 0)
    normalised = (counted - network.mean) / np.sqrt(network.variance)
    np.testing.assert_allclose(normalised.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(normalised.std(axis=0), [1.0, 1.0, 1.0, 0.0], atol=1e-9)


@pytest.fixture(scope="module")
def one_step(estimated):
    """A step of an episode, which every batch repeats, and the network of its dataset."""
    step = Dataset(*(each[:1, 20:21] for each in estimated))
    return step, Network(FEEDFORWARD, estimated, 0)


def test_the_loss_is_the_regret_of_the_policys_torque_per_second(one_step):
    step, network = one_step
    (loss,) = network.fit([step], 1, (0.0, 0.0), np.random.default_rng(0))
    action = network.policy("student", 0, "none").start([0])(step.inputs[:, 0])
    regrets = torch.from_numpy(step.regrets[:, 0].astype(np.float32))
    regret = interpolated_regret(regrets, torch.from_numpy(action[:, 0])).item()
    assert loss == pytest.approx(regret / 0.02, rel=1e-3)


def test_the_step_size_changes_linearly(one_step):
    step, network = one_step
    rates = []
    network.optimiser.register_step_pre_hook(
        lambda optimiser, *_: rates.append(optimiser.param_groups[0]["lr"])
    )
    network.fit([step], 4, (8e-6, 4e-6), np.random.default_rng(0))
    assert rates == pytest.approx([8e-6, 7e-6, 6e-6, 5e-6])


@pytest.mark.parametrize(("size", "bounded"), [(1e-4, False), (1.0, True)])
def test_a_gradient_is_that_of_its_own_batch_with_a_norm_of_at_most_1(one_step, size, bounded):
    step, network = one_step
    scaled = step._replace(regrets=size * step.regrets.astype(np.float32))
    norms = []
    for updates in (1, 3):
        network.fit([scaled], updates, (0.0, 0.0), np.random.default_rng(0))
        gradients = [parameter.grad.ravel() for parameter in network.module.parameters()]
        norms.append(torch.cat(gradients).norm().item())
    assert norms[1] == pytest.approx(norms[0], rel=1e-3)
    assert (norms[0] == pytest.approx(1.0, rel=1e-3)) == bounded


def test_a_fit_lowers_the_loss(dataset):
    network = Network(RECURRENT, dataset, 0)
    losses = network.fit([dataset], 150, (5e-3, 0.0), np.random.default_rng(0))
    assert len(losses) == 150
    assert np.mean(losses[-20:]) < 0.5 * np.mean(losses[:5])


def drawn_sequences(**settings):
    student = dataclasses.replace(RECURRENT, batch_size=4000, **settings)
    running = np.ones((3, student.steps), bool)
    running[1, 25:] = False
    dataset = Dataset(np.zeros((3, student.steps, 5), np.float32), np.zeros(0), running)
    (episodes, steps), counts = Network(student, dataset, 0)._sequences(
        running, np.random.default_rng(0)
    )
    return episodes, steps, counts


def test_a_sequence_counts_after_its_burn_in_unless_it_begins_an_episode():
    episodes, steps, counts = drawn_sequences(sequence=20, burn_in=5)
    assert {*episodes.flat} == {0, 1, 2}
    assert {*steps[0].tolist()} == {*range(21)}
    assert (np.diff(steps, axis=0) == 1).all()
    begins = steps[0] == 0
    ended = (episodes == 1) & (steps >= 25)
    assert not counts[ended].any()
    assert (counts | ended)[:, begins].all()
    assert not counts[:5, ~begins].any()
    assert (counts | ended)[5:].all()


def test_a_share_of_the_sequences_begins_an_episode():
    _, steps, _ = drawn_sequences(sequence=20)
    # The others begin at one of 21 steps.
    assert (steps[0] == 0).mean() == pytest.approx(0.15 + 0.85 / 21.0, abs=0.02)
    _, steps, _ = drawn_sequences(sequence=1, units=0)
    assert (steps[0] == 0).mean() < 0.1
