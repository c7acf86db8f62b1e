import math

import numpy as np
import pytest

from benchmarks.sensitivity import START, draw, errors
from capsule_gym import Capsule, CapsuleEnv, sensitivity
from capsule_gym.core import _core

EVERY = (*("M", "mu", "m", "l", "g", "k", "c", "static_ratio", "backward_ratio"),)
EXTENDED = ("viscous", "stribeck_speed", "slope", "motor_friction")


def test_derivatives_through_events_equal_extrapolated_differences():
    found, events = errors(12, seed=3)
    assert events > 10 and found.max() < 1e-7


@pytest.mark.parametrize("level", _core.LEVELS)
def test_values_have_the_bits_of_the_environment(level, select_level):
    select_level(level)
    capsule, torques = (
        Capsule(mu=0.2, static_ratio=1.3),
        np.float32([0.5, -0.9, 0.9, 0.3, -0.8, 0.6] * 8),
    )
    env = CapsuleEnv(capsule=capsule, randomization="none", torque_limit=1.0)
    env.reset(seed=0)
    states = [env.step(np.array([torque]))[4]["state"] for torque in torques]
    plain = sensitivity((-math.pi / 3, 0.0, 0.0, 0.0), torques.astype(float), (), capsule=capsule)
    differentiated = sensitivity(
        (-math.pi / 3, 0.0, 0.0, 0.0), torques.astype(float), capsule=capsule
    )
    assert plain.events[-1] > 5
    assert np.array_equal(plain.states[1:], states) and np.array_equal(
        plain.states, differentiated.states
    )


def end(size, name, capsule, state, torques, **periods):
    """The state at the end of a trajectory, by a change of a constant."""
    shifted = Capsule(**{**vars(capsule), name: getattr(capsule, name) + size})
    return sensitivity(state, torques, (), capsule=shifted, **periods).states[-1]


@pytest.mark.parametrize("name", [*EVERY, *EXTENDED, "paper"])
def test_every_constant_has_its_derivative(name):
    extended = {"viscous": 0.3, "stribeck_speed": 0.2, "slope": 0.02, "motor_friction": 0.05}
    capsule = Capsule(
        mu=0.2, static_ratio=1.3, backward_ratio=1.2, **(extended if name in EXTENDED else {})
    )
    if name == "paper":
        name, capsule = "mu", Capsule(mu=0.2, normal_force="paper")
    torques = draw(np.random.default_rng(2))[1][:40]
    slope = sensitivity(START, torques, (name,), capsule=capsule, control_dt=0.01).derivatives[
        name
    ][-1]
    h = 1e-5 * getattr(capsule, name)
    ends = [
        end(n * h, name, capsule, START, torques, control_dt=0.01) for n in (-2.0, -1.0, 1.0, 2.0)
    ]
    expected = np.array([1.0, -8.0, 8.0, -1.0]) @ ends / (12.0 * h)
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("name", ["viscous", "slope", "motor_friction", "static_ratio"])
def test_a_constant_without_effect_has_its_derivative(name):
    """The core skips terms whose factor is 0; with the factor 0 of `static_ratio` the Stribeck
    curve is level."""
    capsule = Capsule(stribeck_speed=0.1)
    torques, state = draw(np.random.default_rng(2))[1][:6], (-0.3, 0.5, 0.0, 0.2)
    slope = sensitivity(state, torques, (name,), capsule=capsule).derivatives[name][-1]
    expected = (
        np.array([-3.0, 4.0, -1.0])
        @ [end(n * 1e-6, name, capsule, state, torques) for n in range(3)]
        / 2e-6
    )
    assert abs(slope).max() > 1e-3
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-8)


def test_torques_and_state_and_no_derivative_by_friction_in_stick():
    torques = draw(np.random.default_rng(2))[1][:30]
    found = sensitivity(START, torques, ("torque", "torques", "state"), control_dt=0.01).derivatives
    np.testing.assert_allclose(found["torques"] @ torques, found["torque"], rtol=1e-12, atol=1e-15)
    # A torque acts on no earlier state, and x on nothing but itself.
    assert not np.triu(found["torques"][:, 1]).any()
    assert np.array_equal(found["state"][0], np.eye(4)) and np.array_equal(
        found["state"][-1, :, 2], [0, 0, 1, 0]
    )
    # A platform that sticks loses a velocity of either sign at once.
    shifted = np.array([-1.0, 0.2, 0.0, 0.0]) + 1e-6 * np.multiply.outer(
        [-2.0, -1.0, 1.0, 2.0], np.eye(4)
    )
    own, plant = [0.3, -0.4] * 9, {"capsule": Capsule(mu=0.2)}
    ends = [
        [sensitivity(start, own, (), **plant).states[-1] for start in starts] for starts in shifted
    ]
    expected = np.tensordot([1.0, -8.0, 8.0, -1.0], ends, 1).T / 12e-6
    found = sensitivity([-1.0, 0.2, 0.0, 0.0], own, ("state",), **plant)
    np.testing.assert_allclose(found.derivatives["state"][-1], expected, rtol=1e-5, atol=1e-6)
    found = sensitivity(
        (0.1, 0.0, 0.0, 0.0), [0.0] * 20, ("mu", "static_ratio"), capsule=Capsule(mu=0.5)
    )
    assert not found.events.any() and not any(slopes.any() for slopes in found.derivatives.values())
