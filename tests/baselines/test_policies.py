import pickle

import numpy as np
import pytest

import baselines
from baselines import lqr, mpc
from baselines.laws import LAWS
from baselines.policies import ALL_SCRIPTED
from capsule_gym import CapsuleVectorEnv
from capsule_gym.controller import Controller


@pytest.mark.parametrize("name", ALL_SCRIPTED)
def test_a_policy_can_be_pickled(name):
    assert pickle.loads(pickle.dumps(ALL_SCRIPTED[name])).start.__class__ is ALL_SCRIPTED[name].start.__class__


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_controller_and_a_policy_with_a_zero_residual(name):
    controller = getattr(baselines, name)()
    (policy,) = (each for each in ALL_SCRIPTED.values() if each.env_kwargs.get("controller") == f"baselines:{name}")
    assert isinstance(controller, Controller) and policy.env_kwargs.get("task") == controller.task
    assert policy.start([0, 1])(np.zeros((2, 10), np.float32)).tolist() == [[0.0], [0.0]]


def drive(start, count, steps):
    env = CapsuleVectorEnv(count, randomization="none", autoreset_mode="DISABLED")
    observations, _ = env.reset(seed=0)
    act, taken = start(range(count)), []
    for _ in range(steps):
        taken.append(act(observations))
        observations, *_ = env.step(taken[-1])
    metrics = env.episode_metrics()
    return np.array(taken), metrics


@pytest.mark.parametrize(("start", "steps", "distance"), [(mpc.start, 150, 0.22), (lqr.start, 500, 0.9)])
def test_a_planned_policy_moves_and_an_episode_does_not_depend_on_others(start, steps, distance):
    (alone, metrics), (among, _) = (drive(start, count, steps) for count in (1, 3))
    assert metrics["distance"][0] > distance and metrics["failed"][0] == 0.0
    assert alone.dtype == np.float32 and (np.abs(alone) <= 1.0).all()
    assert np.array_equal(alone[:, 0], among[:, 0])
