import json
import pickle

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import baselines
from baselines import lqr, mpc
from baselines.dynamic_programming.archive import known_results
from baselines.dynamic_programming.problem import Problem, Transitions
from baselines.policies import ALL_SCRIPTED
from capsule_gym import CapsuleVectorEnv
from capsule_gym.control.controller import Controller
from capsule_gym.control.laws import LAWS
from capsule_gym.tasks.task import TORQUE_LIMIT


@pytest.mark.parametrize("policy", ALL_SCRIPTED.values(), ids=ALL_SCRIPTED)
def test_a_policy_can_be_pickled(policy):
    restored = pickle.loads(pickle.dumps(policy))
    assert restored.start.__class__ is policy.start.__class__


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_controller(name):
    assert isinstance(getattr(baselines, name)(), Controller)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_policy_with_a_zero_residual(name):
    law = f"baselines:{name}"
    policies = ALL_SCRIPTED.values()
    (policy,) = (each for each in policies if each.env_kwargs.get("controller") == law)
    assert policy.env_kwargs.get("task") == getattr(baselines, name)().task
    act = policy.start([0, 1])
    assert act(np.zeros((2, 10), np.float32)).tolist() == [[0.0], [0.0]]


def drive(start, count, steps):
    """Actions, shape (steps, count, 1), and metrics of episodes of a policy."""
    env = CapsuleVectorEnv(count, randomization="none", autoreset_mode="DISABLED")
    observations, _ = env.reset(seed=0)
    act = start(range(count))
    actions = []
    for _ in range(steps):
        actions.append(act(observations))
        observations, *_ = env.step(actions[-1])
    return np.array(actions), env.episode_metrics()


@pytest.mark.parametrize(
    ("start", "steps", "distance"), [(mpc.start, 150, 0.22), (lqr.start, 500, 0.9)]
)
def test_a_planned_policy_moves(start, steps, distance):
    actions, metrics = drive(start, 1, steps)
    assert metrics["distance"][0] > distance
    assert metrics["failed"][0] == 0.0
    assert actions.dtype == np.float32
    assert (np.abs(actions) <= 1.0).all()


@pytest.mark.parametrize(("start", "steps"), [(mpc.start, 150), (lqr.start, 500)])
def test_an_episode_of_a_planned_policy_does_not_depend_on_others(start, steps):
    alone, _ = drive(start, 1, steps)
    among, _ = drive(start, 3, steps)
    assert np.array_equal(alone[:, 0], among[:, 0])


@pytest.fixture
def plans(monkeypatch):
    """The plans of `mpc` at its first two control intervals from rest, and its first action."""
    torques = []

    class RecordedTransitions(Transitions):
        def step(self, states, actions):
            torques.append(actions.copy())
            return super().step(states, actions)

    monkeypatch.setattr(mpc, "Transitions", RecordedTransitions)
    act = mpc.start([0])
    action = act(np.zeros((1, 4), np.float32)).item()
    act(np.zeros((1, 4), np.float32))
    first, second = np.reshape(torques, (2, mpc.INTERVALS, mpc.PLANS))
    return first.T, second.T, action


def test_disturbances_of_a_plan_are_linear_and_bounded(plans):
    first, _, _ = plans
    np.testing.assert_allclose(np.diff(first, 2, axis=1), 0.0, atol=1e-12)
    assert not first[0].any()
    assert (first[1:, 0] != first[1:, -1]).all()
    assert (np.abs(first) <= mpc.AMPLITUDES).all()
    largest = first[mpc.AMPLITUDES[:, 0] == 1.0]
    assert largest.min() < -0.8
    assert largest.max() > 0.8


def test_a_plan_continues_the_best_of_the_previous_step(plans):
    first, second, action = plans
    (best,) = first[first[:, 0].astype(np.float32) == action]
    assert second[0].tolist() == [*best[1:], best[-1]]


def test_a_constant_system_has_the_gains_of_the_algebraic_riccati_equation():
    A = np.array([[1.0, 0.1, 0.0], [0.2, 0.9, 0.05], [0.0, -0.1, 0.98]])
    B = np.array([0.0, 0.4, 0.1])
    deviation = 0.3
    R = deviation**-2.0
    P = solve_discrete_are(A, B[:, None], np.diag(lqr.DEVIATIONS**-2.0), [[R]])
    expected = B @ P @ A / (R + B @ P @ B)

    gains = lqr.riccati_gains(np.tile(A, (4, 1, 1)), np.tile(B, (4, 1)), deviation)

    np.testing.assert_allclose(gains, np.tile(expected, (4, 1)), rtol=1e-9)


@pytest.fixture(scope="module")
def content():
    return json.loads(lqr.FILE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def linearised(content):
    """States, distance (cm) and derivatives along the cycle on file."""
    start = np.array(content["states"][0])
    return lqr.linearise(Transitions(Problem(), 9), start, np.array(content["torques"]))


def test_the_cycle_on_file_is_closed(content, linearised):
    states, *_ = linearised
    np.testing.assert_allclose(states[:-1], content["states"], atol=1e-9)
    assert (np.abs(states[-1] - states[0]) < 1e-5).all()


def test_the_cycle_on_file_is_fast(content, linearised):
    _, distance, _, _ = linearised
    duration = 0.02 * len(content["torques"])
    # The gain of dynamic programming, a little above that of any policy.
    assert 20.0 < distance / duration < known_results().results[Problem().key].gains[-1]


def test_the_regulator_on_file_stabilises_an_unstable_cycle(content, linearised):
    *_, A, B = linearised
    free = np.eye(3)
    closed = np.eye(3)
    for a, b, k in zip(A, B, content["gains"], strict=True):
        free = a @ free
        closed = (a - np.outer(b, k)) @ closed
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    assert np.abs(np.linalg.eigvals(free)).max() > 1.0


def test_states_torques_and_gains_are_linear_between_control_intervals():
    content = {
        "states": [[0.0, 1.0, 2.0], [8.0, 17.0, 26.0]],
        "torques": [0.0, 8.0],
        "gains": [[3.0, 4.0, 5.0], [-5.0, 4.0, 13.0]],
    }
    # Eight phases from the first step to the second, and eight back.
    share = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 7, 6, 5, 4, 3, 2, 1])
    rows = [(0, 1), (1, 2), (2, 3), (0, 1), (3, -1), (4, 0), (5, 1)]
    expected = [first + slope * share for first, slope in rows]
    np.testing.assert_allclose(lqr.interpolate(content), expected, atol=1e-12)


def test_the_torque_on_the_cycle_is_corrected_by_the_gains(content):
    states = np.array(content["states"])
    for deviation in (np.zeros(3), np.array([2e-3, -1e-2, 3e-4])):
        act = lqr.start([0])
        observed = np.tile((states + deviation).astype(np.float32), (2, 1))
        actions = [act(each[None]).item() for each in observed]
        torques = np.array(content["torques"]) - np.array(content["gains"]) @ deviation
        expected = np.clip(torques / TORQUE_LIMIT, -1.0, 1.0)
        np.testing.assert_allclose(actions, np.tile(expected, 2), atol=1e-5)


def regulator(states):
    """A regulator without gains, whose torque is the index of the state over 100."""
    states = np.asarray(states)
    torques = np.arange(len(states)) / 100.0
    return np.column_stack([states, torques, np.zeros_like(states)]).T


def chosen(act, state):
    return round(100.0 * TORQUE_LIMIT * act(np.array([state], np.float32)).item())


@pytest.mark.parametrize("nearest", [0, 1, 2])
def test_a_deviation_of_0_3_rad_is_as_far_as_3_rad_per_s_and_0_15_m_per_s(nearest):
    deviations = np.diag([0.1, 1.0, 0.05])
    deviations[nearest] *= 0.9
    act = lqr.start([0], regulator(deviations))
    assert chosen(act, [0.0, 0.0, 0.0]) == nearest


def test_the_phase_advances_by_a_control_interval_or_up_to_1_5_more_or_less():
    states = np.zeros((100, 3))
    states[:, 0] = np.arange(100)
    act = lqr.start([0], regulator(states))
    assert chosen(act, states[10]) == 10
    assert chosen(act, states[60]) == 10 + 8 + 12
    assert chosen(act, states[10]) == 30 + 8 - 12
    assert chosen(act, states[33]) == 33


def test_the_regulator_on_file_is_one_of_the_designs(content):
    intervals = len(content["torques"])
    differences = []
    for design in lqr.candidates():
        if len(design["torques"]) == intervals:
            pairs = [(design[name], content[name]) for name in content]
            differences.append(max(np.abs(np.subtract(*pair)).max() for pair in pairs))
    assert len(differences) == len(lqr.TORQUE_DEVIATIONS)
    nearest, second, *_ = sorted(differences)
    assert nearest < 1e-6
    assert second > 1e-6


def test_no_regulator_follows_a_cycle_that_does_not_close(monkeypatch):
    monkeypatch.setattr(lqr, "close_cycle", lambda _, *cycle: (-np.inf, *cycle))
    assert list(lqr.candidates()) == []
