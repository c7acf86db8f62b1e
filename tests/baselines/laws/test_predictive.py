"""The observer and the predictor: their estimates, and the performance of the laws on late measurements."""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
import pytest

from baselines.laws.adaptive import adaptive
from baselines.laws.gait import LIGHTEST, gait
from baselines.laws.predictive import (
    CONTACT_MARGIN,
    LAG,
    LATENCY,
    MEMORY,
    MOTOR_FRICTION,
    MOTOR_WIDTH,
    Estimate,
    adaptive_predictive,
    gait_predictive,
    keep_contact,
    model_step,
    predict,
)
from capsule_gym import CapsuleVectorEnv, Controller, contact, dynamics
from capsule_gym.config import LAW_DT
from capsule_gym.elementary import clip
from capsule_gym.layout import ROWS
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import HORIZON, START_THETA, TORQUE_LIMIT

PLANT = NOMINAL.plant()
# Places in the memory of `late`: the motor's torque, then the law's own memory. The measurements come first.
MOTOR = 3 * LATENCY
OWN = MOTOR + 1
SLIDING = Estimate(1.0, 0.4, -5.0, 0.3, 0.5, NOMINAL.M, NOMINAL.mu, 0.0)


def advance(state, motor, torque, plant, steps=1):
    """Advances the plant and its motor, with lag and friction, by one call of the law.

    Args:
        state: theta (rad), theta_dot (rad/s), x (m), x_dot (m/s).
        motor: the motor's torque behind the lag, N m.
        torque: the law's torque, N m.
        plant: the plant's constants.
        steps: integrator steps; the motor's torque is constant during each.
    """
    h = LAW_DT / steps
    for _ in range(steps):
        motor = torque + (motor - torque) * math.exp(-h / LAG)
        u = motor - MOTOR_FRICTION * min(1.0, max(-1.0, state[1] / MOTOR_WIDTH))
        state = contact.step(*state, u, plant, h)[:4]
    return state, motor


def late(controller):
    """Wraps the law: its measurements are LATENCY calls late, and the motor has lag and friction."""
    inner, share = numba.njit(controller.law), 1.0 - math.exp(-LAW_DT / LAG)

    def law(theta, theta_dot, x, x_dot, memory, reference):
        then = memory[:3]
        torque, own = inner(then[0], then[1], math.nan, then[2], memory[OWN:], reference)
        motor = memory[MOTOR] + share * (torque - memory[MOTOR])
        u = motor - MOTOR_FRICTION * clip(theta_dot / MOTOR_WIDTH, 1.0)
        return u, (*memory[3:MOTOR], theta, theta_dot, x_dot, motor, *own)

    buffer = (START_THETA, 0.0, 0.0) * LATENCY
    return Controller(controller.name, law, controller.reference, (*buffer, 0.0, *controller.memory))


def episode(controller, plants):
    """Runs an episode on plants of M (kg) and mu, and returns the batch."""
    env = CapsuleVectorEnv(len(plants), controller=controller, control_dt=0.1, autoreset_mode="DISABLED")
    M, mu = np.array(plants).T
    env.reset(seed=0, options={"M": M, "mu": mu})
    for _ in range(round(HORIZON / 0.1)):
        env.step(np.zeros((len(plants), 1), np.float32))
    return env


def test_the_model_is_exact_to_first_order():
    torque, duration = -1.0, 0.009
    state, motor = (SLIDING.theta, SLIDING.theta_dot, 0.0, SLIDING.x_dot), SLIDING.motor
    for _ in range(9):
        state, motor = advance(state, motor, torque, PLANT, steps=200)
    errors = []
    for steps in (3, 6, 12):
        estimate = SLIDING
        for _ in range(steps):
            estimate = model_step(estimate, torque, duration / steps)
        found = (estimate.theta, estimate.theta_dot, estimate.x_dot, estimate.motor)
        errors.append(np.abs(np.subtract(found, (state[0], state[1], state[3], motor))))
    assert (errors[0] < (1e-3, 0.1, 0.01, 0.2)).all()
    assert (errors[0] > 1.6 * errors[1]).all()
    assert (errors[1] > 1.6 * errors[2]).all()


def test_the_prediction_follows_the_plant_through_the_queued_torques():
    queue = tuple(np.random.default_rng(0).uniform(-TORQUE_LIMIT, TORQUE_LIMIT, LATENCY).tolist())
    state, motor = (SLIDING.theta, SLIDING.theta_dot, 0.0, SLIDING.x_dot), SLIDING.motor
    present, kept = predict((*SLIDING, *queue), SLIDING.theta, SLIDING.theta_dot, SLIDING.x_dot)
    for torque in queue:
        state, motor = advance(state, motor, torque, PLANT, steps=20)
    moved = np.subtract((state[0], state[1], state[3]), (SLIDING.theta, SLIDING.theta_dot, SLIDING.x_dot))
    missed = np.subtract((present.theta, present.theta_dot, present.x_dot), (state[0], state[1], state[3]))
    assert (np.abs(missed) < 0.05 * np.abs(moved)).all()
    # The memory drops the oldest torque; the law adds the newest one.
    assert kept[len(SLIDING) :] == queue[1:]


def test_mass_and_friction_are_learnt_and_the_gait_is_fast_on_late_measurements():
    plants = [(0.5, 0.01), (0.6, 0.1), (0.38, 0.05), (0.75, 0.2), (0.4, 0.25)]
    env = episode(late(gait_predictive()), plants)
    metrics = env.episode_metrics()
    assert metrics["failed"].sum() == 0.0
    assert metrics["mean_speed"].min() > 12.0
    first = ROWS + OWN
    M, mu, bias = (env.simulation.row(first + Estimate._fields.index(name)) for name in ("M", "mu", "bias"))
    assert M == pytest.approx(np.array(plants)[:, 0], rel=0.15)
    assert mu == pytest.approx(np.array(plants)[:, 1], rel=0.25)
    assert np.abs(bias).max() < 0.02
    # The gait without observer and predictor, with the same sensors and motor.
    alone = episode(late(gait()), plants).episode_metrics()
    assert (alone["mean_speed"] < 5.0).all()


def test_the_adaptive_law_tracks_on_late_measurements():
    found = [episode(law, [(0.5, 0.01)]).episode_metrics() for law in (adaptive(), late(adaptive_predictive()))]
    ideal, predicted = (float(metrics["mean_speed"][0]) for metrics in found)
    assert predicted == pytest.approx(ideal, rel=0.05)


@pytest.mark.parametrize("controller", [gait_predictive(), adaptive_predictive()], ids=lambda found: found.name)
def test_torque_and_memory_are_finite_whatever_is_measured(controller):
    rng, memory, row = np.random.default_rng(0), controller.memory, tuple(controller.reference[0].tolist())
    values = (0.0, 1e-300, 0.1, 1.0, 1e3, 1e300, math.inf)
    for _ in range(300):
        theta, theta_dot, x_dot = (float(rng.choice(values) * rng.choice((-1.0, 1.0))) for _ in range(3))
        torque, memory = controller.law(theta, theta_dot, 0.0, x_dot, memory, row)
        assert abs(torque) <= TORQUE_LIMIT
        assert np.isfinite(memory).all()


def test_a_torque_that_would_lift_the_lightest_platform_is_reduced():
    plant = NOMINAL.plant(M=LIGHTEST, mu=0.0)
    least = CONTACT_MARGIN * (LIGHTEST + NOMINAL.m) * NOMINAL.g
    reduced = 0
    for theta, theta_dot, torque in itertools.product((-1.0, -0.5, 0.5, 1.0), (-8.0, 0.0, 8.0), (-1.5, 0.5, 1.5)):
        kept = keep_contact(torque, theta, theta_dot)
        normal, after = (dynamics.accelerations(theta, theta_dot, 0.1, 1.0, u, plant)[2] for u in (torque, kept))
        if normal >= least:
            assert kept == torque
        elif kept != torque:
            reduced += 1
            assert after == pytest.approx(least, rel=1e-9) or kept == 0.0
    assert reduced > 0
    assert keep_contact(1.5, 0.0, 20.0) == 1.5


def test_the_memory_begins_with_the_first_measurement():
    theta, theta_dot, x_dot = 0.3, -1.0, 0.1
    _, kept = predict(MEMORY, theta, theta_dot, x_dot)
    start = Estimate(1.0, theta, theta_dot, x_dot, *MEMORY[4:8])
    assert kept[:8] == model_step(start, 0.0, LAW_DT)
