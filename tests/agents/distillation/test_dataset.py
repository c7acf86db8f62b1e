import dataclasses

import numpy as np

from agents.distillation import dataset
from agents.distillation.dataset import collect
from baselines.dynamic_programming.policy import NUM_TORQUES
from capsule_gym.parameters import NOMINAL
from tests.agents.distillation.conftest import FEEDFORWARD, RECURRENT

# Columns of the observation: the last action; with estimates, their standard deviations from 7 on.
LAST_ACTION = 4
ESTIMATES = slice(5, 9)
M_DEVIATION = 7


def collected(student, solved, *, expert_share=1.0, act=None, **settings):
    groups, solutions = solved
    student = dataclasses.replace(student, **settings)
    return collect(student, groups, solutions, np.random.default_rng(0), expert_share, act)


def test_a_dataset_has_all_steps_of_all_episodes(solved):
    data = collected(RECURRENT, solved)
    assert data.inputs.shape == (4, 40, 5)
    assert data.regrets.shape == (4, 40, NUM_TORQUES)
    assert data.running.all()
    # Sensors are disturbed in three of the four groups: at rest not every angle reads the start.
    assert np.ptp(data.inputs[:, 0, 0]) > 0.0


def test_the_best_torque_has_no_regret(solved):
    data = collected(RECURRENT, solved)
    assert (data.regrets.min(axis=-1) == 0.0).all()
    assert data.regrets.max() > 0.1
    assert data.regrets.max() <= RECURRENT.max_regret


def test_steps_after_the_end_of_an_episode_do_not_count(solved):
    def full(observations):
        return np.ones((len(observations), 1), np.float32)

    data = collected(RECURRENT, solved, expert_share=0.0, act=full, steps=200)
    ended = ~data.running
    assert ended[:, -1].all()
    # An ended episode does not begin again, and the others go on.
    assert (np.diff(ended.astype(int), axis=1) >= 0).all()
    assert np.ptp(data.running.sum(axis=1)) > 0


def test_plants_change_within_episodes(solved_nominal):
    observed = {"observation": {"observe_parameters": True}}
    constant = collected(FEEDFORWARD, solved_nominal, change_rate=0.0, **observed)
    changing = collected(FEEDFORWARD, solved_nominal, change_rate=10.0, **observed)
    for column in (-2, -1):
        assert (np.ptp(constant.inputs[..., column], axis=1) == 0.0).all()
        assert (np.ptp(changing.inputs[..., column], axis=1) > 0.0).all()


def test_a_student_observes_the_estimates(solved_nominal):
    inputs = collected(FEEDFORWARD, solved_nominal, steps=150, change_rate=0.0).inputs
    first = inputs[:, 0]
    last = inputs[:, -1]
    assert (first[:, ESTIMATES] == first[0, ESTIMATES]).all()
    assert (last[:, M_DEVIATION] < 0.2 * first[:, M_DEVIATION]).all()


def test_a_torque_costs_more_by_the_share_of_the_margin_that_it_does_not_leave():
    scores = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 2.0]])
    normal_force = np.array([[12.0, 5.0, 0.0], [0.0, -5.0, -10.0]])
    regrets = dataset._regret(scores, normal_force, np.full((2, 1), 10.0), 60.0)
    assert regrets.tolist() == [[0.0, 30.0, 60.0], [2.0, 1.0, 0.0]]


def first_regrets(solved_nominal, margin, spare_share=0.0):
    settings = {"steps": 1, "max_regret": 100.0, "margin": margin, "spare_share": spare_share}
    return collected(FEEDFORWARD, solved_nominal, **settings).regrets.astype(float)


def test_a_torque_that_leaves_less_normal_force_than_the_margin_costs_more(solved_nominal):
    wide = first_regrets(solved_nominal, 20.0)
    narrow = first_regrets(solved_nominal, 1.0)
    assert wide.mean() > narrow.mean() + 10.0


def test_the_weight_that_a_change_may_take_away_enlarges_the_margin(solved_nominal):
    groups, _ = solved_nominal
    lightest = min(problem.M for group in groups for problem in group.targets)
    observed = {"observation": {"observe_parameters": True}, "steps": 1}
    masses = collected(FEEDFORWARD, solved_nominal, **observed).inputs[:, 0, -2]
    assert masses.max() > lightest + 0.05
    found = first_regrets(solved_nominal, 1.0, spare_share=0.5)
    for episode, M in enumerate(masses):
        margin = 1.0 + 0.5 * NOMINAL.g * (M - lightest)
        expected = first_regrets(solved_nominal, margin)[episode]
        np.testing.assert_allclose(found[episode], expected, rtol=2e-3, atol=1e-2)


def test_the_acting_policy_decides_the_states(solved):
    shapes = set()

    def zero(observations):
        shapes.add(observations.shape)
        return np.zeros((len(observations), 1), np.float32)

    alone = collected(RECURRENT, solved, expert_share=0.0, act=zero)
    assert shapes == {(4, 5)}
    assert np.abs(alone.inputs[..., LAST_ACTION]).mean() < 0.1
    assert np.abs(collected(RECURRENT, solved).inputs[..., LAST_ACTION]).mean() > 0.1


def test_random_actions_cover_their_range(solved, monkeypatch):
    monkeypatch.setattr(dataset, "EXPLORATION_PROBABILITY", 1.0)
    actions = collected(RECURRENT, solved).inputs[:, 1:, LAST_ACTION]
    lowest, middle, highest = np.quantile(actions, [0.02, 0.5, 0.98])
    assert -1.0 < lowest < -0.85
    assert abs(middle) < 0.3
    assert 0.85 < highest < 1.0


def test_the_same_generator_gives_the_same_data(solved):
    settings = {"change_rate": 3.0}
    first = collected(RECURRENT, solved, **settings)
    assert (first.inputs == collected(RECURRENT, solved, **settings).inputs).all()
