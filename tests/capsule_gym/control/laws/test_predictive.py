"""The observer and the predictor: their estimates, and the performance of the law on late
measurements."""

import itertools
import math

import numpy as np
import pytest

from capsule_gym import CapsuleVectorEnv, Disturbances, dynamics
from capsule_gym.control.controller import LAW_DT, CoreLaw
from capsule_gym.control.laws.gains import plant_constants
from capsule_gym.control.laws.gait import LIGHTEST, PARAMETERS, gait, gait_predictive
from capsule_gym.core.layout import NUM_ROWS
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import HORIZON, TORQUE_LIMIT

PLANT = NOMINAL.plant()
# What the laws assume: calls from a measurement to its torque, the motor's time constant in s, its
# friction in N m, and the speed in rad/s from which this acts fully; smallest normal force as a
# share of the weight.
LATENCY, LAG, MOTOR_FRICTION, MOTOR_WIDTH, CONTACT_MARGIN = 10, 0.005, 0.05, 0.2, 0.1
M, MU, BIAS = 5, 6, 7
# An estimate that a measurement of the same state does not correct.
THETA, THETA_DOT, X_DOT, MOTOR = 0.4, -5.0, 0.3, 0.5
SLIDING = (1.0, THETA, THETA_DOT, X_DOT, MOTOR, NOMINAL.M, NOMINAL.mu, 0.0)
LATE = Disturbances(latency=LATENCY * LAW_DT, lag=LAG, motor_friction=MOTOR_FRICTION)


def predictive_law(dt=LAW_DT, lightest=LIGHTEST, **gait_parameters):
    """The law around a gait whose other parameters are zero."""
    parameters = {**dict.fromkeys(PARAMETERS, 0.0), **gait_parameters}
    constants = {**parameters, **plant_constants(PLANT), "torque_limit": TORQUE_LIMIT}
    return CoreLaw("gait_predictive", **constants, lightest=lightest, dt=dt)


def call(law, memory, theta=THETA, theta_dot=THETA_DOT, x_dot=X_DOT):
    return law(theta, theta_dot, 0.0, x_dot, memory, (0.0, 0.0))


def advance(state, motor, torque, plant, steps=1):
    """Advances the state and the motor's torque (N m) behind the lag, with friction, by one call of
    the law."""
    h = LAW_DT / steps
    for _ in range(steps):
        motor = torque + (motor - torque) * math.exp(-h / LAG)
        u = motor - MOTOR_FRICTION * min(1.0, max(-1.0, state[1] / MOTOR_WIDTH))
        state = [float(value) for value in dynamics.step(*state, u, plant, h)[:4]]
    return state, motor


def episode(controller, plants, **options):
    """Runs an episode on plants of M (kg) and mu, and returns the batch."""
    env = CapsuleVectorEnv(
        len(plants), controller=controller, control_dt=0.1, autoreset_mode="DISABLED", **options
    )
    M, mu = np.array(plants).T
    env.reset(seed=0, options={"M": M, "mu": mu})
    for _ in range(round(HORIZON / 0.1)):
        env.step(np.zeros((len(plants), 1), np.float32))
    return env


def test_the_model_is_exact_to_first_order():
    torque, duration = -1.0, 0.009
    state, motor = (THETA, THETA_DOT, 0.0, X_DOT), MOTOR
    for _ in range(9):
        state, motor = advance(state, motor, torque, PLANT, steps=200)
    errors = []
    for steps in (3, 6, 12):
        law, estimate = predictive_law(dt=duration / steps), SLIDING
        for _ in range(steps):
            # The measurement agrees with the estimate, which moves by one step of the model with
            # the oldest torque.
            _, memory = call(law, (*estimate, *(torque,) * LATENCY), *estimate[1:4])
            estimate = memory[:8]
        errors.append(np.abs(np.subtract(estimate[1:5], (state[0], state[1], state[3], motor))))
    assert (errors[0] < (1e-3, 0.1, 0.01, 0.2)).all() and (
        np.divide(errors[:2], errors[1:]) > 1.6
    ).all()


def test_the_prediction_follows_the_plant_through_the_queued_torques():
    queue = tuple(np.random.default_rng(0).uniform(-TORQUE_LIMIT, TORQUE_LIMIT, LATENCY).tolist())
    state, motor = (THETA, THETA_DOT, 0.0, X_DOT), MOTOR
    for torque in queue:
        state, motor = advance(state, motor, torque, PLANT, steps=20)
    # Gaits that return a share of one entry of the predicted state each; no platform is light
    # enough to be guarded.
    present = []
    for name, scale, margin in (
        ("phi_100", 1.0, 0.0),
        ("phi_010", 5.0, 0.0),
        ("phi_001", 0.3, 0.004),
    ):
        gait_law = predictive_law(lightest=100.0, guard_from=1e6, **{name: 0.1})
        torque, memory = call(gait_law, (*SLIDING, *queue))
        present.append(torque / (0.1 * TORQUE_LIMIT) * scale - margin)
        # The memory drops the oldest torque and adds the newest one.
        assert memory[len(SLIDING) :] == (*queue[1:], torque)
    moved = np.subtract((state[0], state[1], state[3]), (THETA, THETA_DOT, X_DOT))
    missed = np.subtract(present, (state[0], state[1], state[3]))
    assert (np.abs(missed) < 0.05 * np.abs(moved)).all()


def test_mass_and_friction_are_learnt_and_the_gait_is_fast_on_late_measurements():
    plants = [(0.5, 0.01), (0.6, 0.1), (0.38, 0.05), (0.75, 0.2), (0.4, 0.25)]
    env = episode(gait_predictive(), plants, disturbances=LATE)
    metrics = env.episode_metrics()
    assert metrics["failed"].sum() == 0.0 and metrics["mean_speed"].min() > 12.0
    estimates = {cell: env.simulation.row(NUM_ROWS + cell) for cell in (M, MU, BIAS)}
    # The friction of the environment's motor rises more slowly than that of the model.
    assert estimates[M] == pytest.approx(np.array(plants)[:, 0], rel=0.2)
    assert (
        estimates[MU] == pytest.approx(np.array(plants)[:, 1], rel=0.25)
        and np.abs(estimates[BIAS]).max() < 0.02
    )
    # The gait without observer and predictor, with the same sensors and motor.
    alone = episode(gait(), plants, disturbances=LATE).episode_metrics()
    assert (alone["mean_speed"] < 5.0).all()


def test_torque_and_memory_are_finite_whatever_is_measured():
    controller = gait_predictive()
    rng, memory, row = (
        np.random.default_rng(0),
        controller.memory,
        tuple(controller.reference[0].tolist()),
    )
    values = (0.0, 1e-300, 0.1, 1.0, 1e3, 1e300, math.inf)
    for _ in range(300):
        theta, theta_dot, x_dot = (
            float(rng.choice(values) * rng.choice((-1.0, 1.0))) for _ in range(3)
        )
        torque, memory = controller.law(theta, theta_dot, 0.0, x_dot, memory, row)
        assert abs(torque) <= TORQUE_LIMIT and np.isfinite(memory).all()


def test_a_torque_that_would_lift_the_lightest_platform_is_reduced():
    plant = NOMINAL.plant(M=LIGHTEST, mu=0.0)
    least = CONTACT_MARGIN * (LIGHTEST + NOMINAL.m) * NOMINAL.g

    def kept_of(torque, theta, theta_dot):
        # Nothing moves within the period of this law, so that the predicted state is the measured
        # one.
        law = predictive_law(dt=1e-15, guard_from=1e6, phi_000=torque / TORQUE_LIMIT)
        estimate = (1.0, theta, theta_dot, X_DOT, 0.0, NOMINAL.M, NOMINAL.mu, 0.0)
        return call(law, (*estimate, *(0.0,) * LATENCY), theta, theta_dot)[0]

    reduced = 0
    for theta, theta_dot, torque in itertools.product(
        (-1.0, -0.5, 0.5, 1.0), (-8.0, 0.0, 8.0), (-1.5, 0.5, 1.5)
    ):
        kept = kept_of(torque, theta, theta_dot)
        normal, after = (
            dynamics.accelerations(theta, theta_dot, 0.1, 1.0, u, plant)[2] for u in (torque, kept)
        )
        if normal >= least:
            assert kept == pytest.approx(torque)
        elif kept != pytest.approx(torque):
            reduced += 1
            assert after == pytest.approx(least, rel=1e-9) or kept == 0.0
    assert reduced > 0 and kept_of(1.5, 0.0, 20.0) == 1.5
