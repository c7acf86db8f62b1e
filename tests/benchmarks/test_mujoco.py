"""The same plant in MuJoCo: its motion, its friction, its batch."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import accuracy, contenders, creep, driver
from benchmarks.frictions import CONTACT, FRICTIONLOSS, HOLDING_FRICTIONS, Friction
from capsule_gym.parameters import Capsule


def test_ours_does_not_creep_below_the_limit_and_slips_beyond() -> None:
    for load in creep.LOADS:
        assert creep.ours(load, 2e-3) == creep.Creep(load, 0.0, 0.0)
    assert creep.ours(1.1, 2e-3).largest > 1e-3


def own_trajectory(torques: np.ndarray, mu: float) -> np.ndarray:
    """States of capsule_gym after every hold. In Python, because the compiled loop takes longer to compile."""
    plant = Capsule(mu=mu).plant()
    state, states = accuracy.START, []
    for torque in torques:
        for _ in range(20):
            motion = driver.step(*state, torque, plant, accuracy.HOLD / 20)
            state = (motion.theta, motion.theta_dot, motion.x, motion.x_dot)
        states.append(state)
    return np.array(states)


def mujoco_trajectory(friction: Friction, torques: np.ndarray, mu: float) -> np.ndarray:
    mujoco_capsule = pytest.importorskip("benchmarks.mujoco_capsule", exc_type=ImportError)
    model = mujoco_capsule.build_model(Capsule(mu=mu), friction, "RK4", 1e-3)
    return mujoco_capsule.simulate(model, torques[None], accuracy.START, accuracy.HOLD)[0]


@pytest.fixture(scope="module")
def torques() -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.5, 0.5, 100)


def test_mujoco_has_the_same_plant(torques: np.ndarray) -> None:
    states = mujoco_trajectory(FRICTIONLOSS, torques, 0.0)
    np.testing.assert_allclose(states, own_trajectory(torques, 0.0), rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("friction", HOLDING_FRICTIONS, ids=lambda friction: friction.name)
def test_mujoco_has_about_the_same_friction(friction: Friction, torques: np.ndarray) -> None:
    states = mujoco_trajectory(friction, torques, 0.1)
    with_friction, without = (np.abs(states - own_trajectory(torques, mu)).max() for mu in (0.1, 0.0))
    assert with_friction < 0.03
    assert without > 5.0 * with_friction


def test_mujoco_steps_a_batch_and_begins_again_where_the_ball_meets_the_platform() -> None:
    pytest.importorskip("mujoco")
    stepper = contenders.step_mujoco(CONTACT, "implicitfast", 2e-3, 4, 2)
    stepper.step(3)
    stepper.close()
