import pickle

import numpy as np
import pytest

import baselines
from baselines.laws import LAWS
from baselines.policies import ALL_SCRIPTED
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
