import dataclasses

import numpy as np
import pytest
import torch

from agents.distillation.dataset import Dataset, collect
from agents.distillation.network import BEGINNINGS, Network, interpolated_regret
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
        np.testing.assert_allclose(actions[:, 0], torques[step], atol=1e-5)


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
    assert (np.diff(steps, axis=0) == 1).all()
    begins = steps[0] == 0
    ended = (episodes == 1) & (steps >= 25)
    assert not counts[ended].any()
    assert (counts | ended)[:, begins].all()
    assert not counts[:5, ~begins].any()
    assert (counts | ended)[5:].all()


def test_a_share_of_the_sequences_begins_an_episode():
    _, steps, _ = drawn_sequences(sequence=20)
    assert (steps[0] == 0).mean() > BEGINNINGS
    _, steps, _ = drawn_sequences(sequence=1, units=0)
    assert (steps[0] == 0).mean() < 0.1
