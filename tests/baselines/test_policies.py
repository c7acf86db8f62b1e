import pickle

import numpy as np
import pytest

import baselines
from baselines.laws import LAWS
from baselines.policies import SCRIPTED
from capsule_gym.controller import Controller


@pytest.mark.parametrize("name", SCRIPTED)
def test_a_policy_can_be_pickled(name):
    assert pickle.loads(pickle.dumps(SCRIPTED[name])).start.__class__ is SCRIPTED[name].start.__class__


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_a_controller_and_a_policy_with_a_zero_residual(name):
    assert isinstance(getattr(baselines, name)(), Controller)
    policy = SCRIPTED[LAWS[name].policy]
    assert policy.env_kwargs == {"controller": f"baselines:{name}"}
    assert policy.start([0, 1])(np.zeros((2, 10), np.float32)).tolist() == [[0.0], [0.0]]
