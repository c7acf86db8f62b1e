"""The named scripted policies."""

from __future__ import annotations

import pickle

import pytest

from baselines.policies import SCRIPTED


@pytest.mark.parametrize("name", SCRIPTED)
def test_a_policy_goes_to_other_processes(name):
    assert pickle.loads(pickle.dumps(SCRIPTED[name])) == SCRIPTED[name]
