import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sensitivity import START, draw, errors
from capsule_gym import Capsule, CapsuleEnv, sensitivity
from capsule_gym.core import _core

PLAIN = Capsule(mu=0.2, static_ratio=1.3, backward_ratio=1.2)
EXTENDED = replace(PLAIN, viscous=0.3, stribeck_speed=0.2, slope=0.02, motor_friction=0.05)
_, TORQUES = draw(np.random.default_rng(2))


def test_derivatives_through_events_equal_extrapolated_differences():
    found, events = errors(12, seed=3)
    assert events > 10
    assert found.max() < 1e-7


@pytest.mark.parametrize("level", _core.LEVELS)
def test_values_have_the_bits_of_the_environment(level, select_level):
    select_level(level)
    capsule = Capsule(mu=0.2, static_ratio=1.3)
    torques = np.float32([0.5, -0.9, 0.9, 0.3, -0.8, 0.6] * 8)
    env = CapsuleEnv(capsule=capsule, randomization="none", torque_limit=1.0)
    env.reset(seed=0)
    states = [env.step(np.array([torque]))[4]["state"] for torque in torques]
    start = (-math.pi / 3, 0.0, 0.0, 0.0)
    plain = sensitivity(start, torques.astype(float), (), capsule=capsule)
    differentiated = sensitivity(start, torques.astype(float), capsule=capsule)
    assert plain.events[-1] > 5
    assert np.array_equal(plain.states[1:], states)
    assert np.array_equal(plain.states, differentiated.states)


def central_difference(function, step):
    """The derivative at 0 by extrapolated central differences."""
    ends = [function(n * step) for n in (-2.0, -1.0, 1.0, 2.0)]
    return np.tensordot([1.0, -8.0, 8.0, -1.0], ends, 1) / (12.0 * step)


def end(capsule, state, torques, **periods):
    """The state at the end of a trajectory."""
    return sensitivity(state, torques, (), capsule=capsule, **periods).states[-1]


PAPER = Capsule(mu=0.2, normal_force="paper")


@pytest.mark.parametrize(
    ("name", "capsule"),
    [
        *((name, PLAIN) for name in ("M", "mu", "m", "l", "g", "k", "c")),
        *((name, PLAIN) for name in ("static_ratio", "backward_ratio")),
        *((name, EXTENDED) for name in ("viscous", "stribeck_speed", "slope", "motor_friction")),
        pytest.param("mu", PAPER, id="paper"),
    ],
)
def test_every_constant_has_its_derivative(name, capsule):
    torques = TORQUES[:40]
    value = getattr(capsule, name)

    def shifted(change):
        return end(replace(capsule, **{name: value + change}), START, torques, control_dt=0.01)

    found = sensitivity(START, torques, (name,), capsule=capsule, control_dt=0.01)
    expected = central_difference(shifted, 1e-5 * value)
    np.testing.assert_allclose(found.derivatives[name][-1], expected, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("name", ["viscous", "slope", "motor_friction", "static_ratio"])
def test_a_constant_without_effect_has_its_derivative(name):
    """The core skips terms whose factor is 0, such as the level Stribeck curve of ratio 1."""
    capsule = Capsule(stribeck_speed=0.1)
    state = (-0.3, 0.5, 0.0, 0.2)
    torques = TORQUES[:6]
    slope = sensitivity(state, torques, (name,), capsule=capsule).derivatives[name][-1]
    values = [getattr(capsule, name) + change for change in (0.0, 1e-6, 2e-6)]
    ends = [end(replace(capsule, **{name: value}), state, torques) for value in values]
    expected = np.array([-3.0, 4.0, -1.0]) @ ends / 2e-6
    assert abs(slope).max() > 1e-3
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-8)


@pytest.fixture(scope="module")
def by_torques_and_state():
    names = ("torque", "torques", "state")
    return sensitivity(START, TORQUES[:30], names, control_dt=0.01).derivatives


def test_the_derivative_by_a_factor_is_that_by_all_torques(by_torques_and_state):
    expected = by_torques_and_state["torques"] @ TORQUES[:30]
    np.testing.assert_allclose(expected, by_torques_and_state["torque"], rtol=1e-12, atol=1e-15)


def test_a_torque_acts_on_no_earlier_state(by_torques_and_state):
    assert not np.triu(by_torques_and_state["torques"][:, 1]).any()


def test_a_position_acts_on_nothing_but_itself(by_torques_and_state):
    by_state = by_torques_and_state["state"]
    assert np.array_equal(by_state[0], np.eye(4))
    assert np.array_equal(by_state[-1, :, 2], [0, 0, 1, 0])


def test_derivatives_by_the_state_equal_differences():
    # A platform that sticks loses a velocity of either sign at once.
    start = np.array([-1.0, 0.2, 0.0, 0.0])
    torques = [0.3, -0.4] * 9
    capsule = Capsule(mu=0.2)

    def shifted(change):
        return [end(capsule, start + change * unit, torques) for unit in np.eye(4)]

    found = sensitivity(start, torques, ("state",), capsule=capsule).derivatives["state"]
    expected = central_difference(shifted, 1e-6).T
    np.testing.assert_allclose(found[-1], expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["mu", "static_ratio"])
def test_friction_has_no_effect_in_stick(name):
    found = sensitivity((0.1, 0.0, 0.0, 0.0), [0.0] * 20, (name,), capsule=Capsule(mu=0.5))
    assert not found.events.any()
    assert not found.derivatives[name].any()
