import json
import pickle

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import baselines
from baselines import lqr, mpc
from baselines.dynamic_programming.problem import Problem, Transitions
from baselines.policies import ALL_SCRIPTED
from capsule_gym import CapsuleVectorEnv
from capsule_gym.control.controller import Controller
from capsule_gym.control.laws import LAWS


@pytest.mark.parametrize("name", ALL_SCRIPTED)
def test_a_policy_can_be_pickled(name):
    assert (
        pickle.loads(pickle.dumps(ALL_SCRIPTED[name])).start.__class__
        is ALL_SCRIPTED[name].start.__class__
    )


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_controller_and_a_policy_with_a_zero_residual(name):
    controller = getattr(baselines, name)()
    (policy,) = (
        each
        for each in ALL_SCRIPTED.values()
        if each.env_kwargs.get("controller") == f"baselines:{name}"
    )
    assert isinstance(controller, Controller) and policy.env_kwargs.get("task") == controller.task
    assert policy.start([0, 1])(np.zeros((2, 10), np.float32)).tolist() == [[0.0], [0.0]]


def drive(start, count, steps):
    env = CapsuleVectorEnv(count, randomization="none", autoreset_mode="DISABLED")
    observations, _ = env.reset(seed=0)
    act, taken = start(range(count)), []
    for _ in range(steps):
        taken.append(act(observations))
        observations, *_ = env.step(taken[-1])
    return np.array(taken), env.episode_metrics()


@pytest.mark.parametrize(
    ("start", "steps", "distance"), [(mpc.start, 150, 0.22), (lqr.start, 500, 0.9)]
)
def test_a_planned_policy_moves_and_an_episode_does_not_depend_on_others(start, steps, distance):
    (alone, metrics), (among, _) = (drive(start, count, steps) for count in (1, 3))
    assert metrics["distance"][0] > distance and metrics["failed"][0] == 0.0
    assert (
        alone.dtype == np.float32
        and (np.abs(alone) <= 1.0).all()
        and np.array_equal(alone[:, 0], among[:, 0])
    )


def test_a_constant_system_has_the_gains_of_the_algebraic_riccati_equation():
    A, B, deviation = (
        np.array([[1.0, 0.1, 0.0], [0.2, 0.9, 0.05], [0.0, -0.1, 0.98]]),
        np.array([0.0, 0.4, 0.1]),
        0.3,
    )
    gains = lqr.riccati_gains(np.tile(A, (4, 1, 1)), np.tile(B, (4, 1)), deviation)
    R = deviation**-2.0
    P = solve_discrete_are(A, B[:, None], np.diag(lqr.DEVIATIONS**-2.0), [[R]])
    np.testing.assert_allclose(gains, np.tile(B @ P @ A / (R + B @ P @ B), (4, 1)), rtol=1e-9)


def test_the_committed_cycle_is_closed_and_its_regulator_a_stable_one_of_the_designs():
    content = {
        name: np.array(values)
        for name, values in json.loads(lqr.FILE.read_text(encoding="utf-8")).items()
    }
    states, distance, A, B = lqr.linearise(
        Transitions(Problem(), 9), content["states"][0], content["torques"]
    )
    np.testing.assert_allclose(states[:-1], content["states"], atol=1e-9)
    assert (np.abs(states[-1] - states[0]) < 1e-5).all() and distance / (
        0.02 * len(content["torques"])
    ) > 20.0
    free, closed = np.eye(3), np.eye(3)
    for a, b, k in zip(A, B, content["gains"], strict=True):
        free, closed = a @ free, (a - np.outer(b, k)) @ closed
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0 < np.abs(np.linalg.eigvals(free)).max()
    content = json.loads(lqr.FILE.read_text(encoding="utf-8"))
    designs = [each for each in lqr.candidates() if len(each["torques"]) == len(content["torques"])]
    differences = [
        max(np.abs(np.subtract(each[name], content[name])).max() for name in content)
        for each in designs
    ]
    assert (
        len(differences) == len(lqr.TORQUE_DEVIATIONS)
        and sorted(differences)[0] < 1e-6 < sorted(differences)[1]
    )
