"""The options: one definition, which signatures, docstrings and command line follow, and what is refused."""

from __future__ import annotations

import dataclasses
import inspect
import math
import pickle
import re

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Randomization
from capsule_gym.parameters import DOCS, EnvConfig
from capsule_gym.simulation import Simulation

FIELDS = {field.name: field for field in dataclasses.fields(EnvConfig)}


def test_the_signature_and_the_page_of_the_environment_list_the_options():
    parameters = inspect.signature(CapsuleEnv).parameters
    assert list(parameters) == [name for name in FIELDS if name != "threads"]
    page = inspect.getdoc(CapsuleEnv)
    for name, parameter in parameters.items():
        assert parameter.kind is inspect.Parameter.KEYWORD_ONLY
        assert parameter.annotation == FIELDS[name].type
        assert parameter.default is FIELDS[name].default or parameter.default == FIELDS[name].default
        assert re.search(rf"^\| `{name}` \| .* \| {re.escape(DOCS[name])} \|$", page, re.MULTILINE), name


def test_what_is_given_is_kept_as_plain_types():
    options = EnvConfig(torque_limit=np.float32(2.0), observe_parameters=np.True_, threads=np.int64(2), control_dt=1)
    assert (options.torque_limit, options.observe_parameters, options.threads) == (2.0, True, 2)
    assert [type(value) for value in (options.torque_limit, options.observe_parameters)] == [float, bool]
    assert (type(options.threads), type(options.control_dt)) == (int, float)
    assert pickle.loads(pickle.dumps(options)) == options
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.torque_limit = 1.0


NUMBERS = [name for name, field in FIELDS.items() if "float" in field.type]


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 10**400, -(10**400)])
def test_numbers_out_of_range_are_refused_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=rf"^{name} must be a .*number.*, got ") as caught:
        EnvConfig(**{name: value})
    assert repr(value) in str(caught.value)


@pytest.mark.parametrize("name", ["torque_limit", "residual_limit", "energy_weight", "termination_penalty"])
def test_numbers_whose_sums_would_be_infinite_are_refused(name):
    with pytest.raises(ValueError, match=rf"^{name} must be a finite number .*, at most 1e\+\d+, got 1e\+300"):
        EnvConfig(**{name: 1e300})


@pytest.mark.parametrize("name", [*NUMBERS, "observe_parameters", "capsule", "randomization", "threads"])
@pytest.mark.parametrize("value", [[1.0], 1j, b"1"])
def test_wrong_types_are_refused_by_name(name, value):
    with pytest.raises(TypeError, match=rf"^{name} must be "):
        EnvConfig(**{name: value})


def test_what_is_none_follows_from_the_others():
    direct = Simulation(1, EnvConfig(torque_limit=2.0)).settings
    assert (direct.residual_limit, direct.physics_dt, direct.physics_steps, direct.law_steps) == (2.0, 2e-3, 10, 1)
    law = Simulation(1, EnvConfig(controller="baselines:adaptive")).settings
    assert (law.residual_limit, law.physics_dt, law.physics_steps, law.law_steps) == (1.5, 1e-3, 1, 20)
    assert Simulation(1).capsule == Capsule()
    assert Simulation(1).randomization == Randomization.named("paper")


@pytest.mark.parametrize("name", FIELDS)
def test_a_value_that_python_does_not_write_out_is_refused_by_name(name):
    with pytest.raises((TypeError, ValueError), match=f"^{name} must be .*, got int of more digits"):
        CapsuleVectorEnv(**{name: 10**5000})
