"""The observer and the predictor: their estimates, and the law on late measurements."""

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
# What the laws assume: calls from a measurement to its torque, the motor's time constant (s), its
# friction (N m), and the speed (rad/s) from which it acts fully.
LATENCY = 10
LAG = 0.005
MOTOR_FRICTION = 0.05
MOTOR_WIDTH = 0.2
# Smallest normal force as a share of the weight.
CONTACT_MARGIN = 0.1
# Cells of the memory.
M, MU, BIAS = 5, 6, 7
# A state, and an estimate that its measurement does not correct.
THETA, THETA_DOT, X_DOT, MOTOR = 0.4, -5.0, 0.3, 0.5
STATE = (THETA, THETA_DOT, 0.0, X_DOT)
SLIDING = (1.0, THETA, THETA_DOT, X_DOT, MOTOR, NOMINAL.M, NOMINAL.mu, 0.0)
# M (kg) and mu.
PLANTS = [(0.5, 0.01), (0.6, 0.1), (0.38, 0.05), (0.75, 0.2), (0.4, 0.25)]
LATE = Disturbances(latency=LATENCY * LAW_DT, lag=LAG, motor_friction=MOTOR_FRICTION)


def predictive_law(dt=LAW_DT, lightest=LIGHTEST, **gait_parameters):
    """The law around a gait whose other parameters are zero."""
    parameters = {**dict.fromkeys(PARAMETERS, 0.0), **gait_parameters}
    constants = {**parameters, **plant_constants(PLANT), "torque_limit": TORQUE_LIMIT}
    return CoreLaw("gait_predictive", **constants, lightest=lightest, dt=dt)


def call(law, memory, theta=THETA, theta_dot=THETA_DOT, x_dot=X_DOT):
    return law(theta, theta_dot, 0.0, x_dot, memory, (0.0, 0.0))


def advance(state, motor, torque, plant, steps=1):
    """Advances the state and the motor's torque (N m), with its lag and friction, by `LAW_DT`."""
    h = LAW_DT / steps
    for _ in range(steps):
        motor = torque + (motor - torque) * math.exp(-h / LAG)
        _, theta_dot, _, _ = state
        friction = MOTOR_FRICTION * np.clip(theta_dot / MOTOR_WIDTH, -1.0, 1.0)
        state = dynamics.step(*state, motor - friction, plant, h)[:4]
    return state, motor


def moving(state):
    """theta, theta_dot and x_dot."""
    theta, theta_dot, _, x_dot = state
    return np.array([theta, theta_dot, x_dot])


def episode(controller, plants, **options):
    """Runs an episode on plants of M (kg) and mu, and returns the batch."""
    count, control_dt = len(plants), 0.1
    env = CapsuleVectorEnv(
        count, controller=controller, control_dt=control_dt, autoreset_mode="DISABLED", **options
    )
    masses, frictions = np.transpose(plants)
    env.reset(seed=0, options={"M": masses, "mu": frictions})
    for _ in range(round(HORIZON / control_dt)):
        env.step(np.zeros((count, 1), np.float32))
    return env


def test_the_model_is_exact_to_first_order():
    torque = -1.0
    state, motor = STATE, MOTOR
    for _ in range(9):
        state, motor = advance(state, motor, torque, PLANT, steps=200)
    errors = []
    for steps in (3, 6, 12):
        law = predictive_law(dt=9 * LAW_DT / steps)
        estimate = SLIDING
        for _ in range(steps):
            # The measurement agrees with the estimate, which moves by one step of the model with
            # the oldest torque.
            _, memory = call(law, (*estimate, *(torque,) * LATENCY), *estimate[1:4])
            estimate = memory[:8]
        errors.append(np.abs(estimate[1:5] - np.append(moving(state), motor)))
    assert (errors[0] < (1e-3, 0.1, 0.01, 0.2)).all()
    assert (np.divide(errors[:2], errors[1:]) > 1.6).all()


def test_the_prediction_follows_the_plant_through_the_queued_torques():
    queue = tuple(np.random.default_rng(0).uniform(-TORQUE_LIMIT, TORQUE_LIMIT, LATENCY).tolist())
    state, motor = STATE, MOTOR
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
    moved = np.abs(moving(state) - moving(STATE))
    missed = np.abs(present - moving(state))
    assert (missed < 0.05 * moved).all()


def late_episode(controller):
    return episode(controller, PLANTS, disturbances=LATE)


def test_mass_and_friction_are_learnt_from_late_measurements():
    simulation = late_episode(gait_predictive()).simulation
    masses, frictions = np.transpose(PLANTS)
    assert simulation.row(NUM_ROWS + M) == pytest.approx(masses, rel=0.2)
    # The friction of the environment's motor rises more slowly than that of the model.
    assert simulation.row(NUM_ROWS + MU) == pytest.approx(frictions, rel=0.25)
    assert np.abs(simulation.row(NUM_ROWS + BIAS)).max() < 0.02


def test_the_gait_is_fast_on_late_measurements():
    metrics = late_episode(gait_predictive()).episode_metrics()
    assert metrics["failed"].sum() == 0.0
    assert metrics["mean_speed"].min() > 12.0


def test_the_gait_is_slow_without_observer_and_predictor():
    metrics = late_episode(gait()).episode_metrics()
    assert metrics["mean_speed"].max() < 5.0


def test_torque_and_memory_are_finite_whatever_is_measured():
    controller = gait_predictive()
    memory = controller.memory
    rng = np.random.default_rng(0)
    values = [0.0, 1e-300, 0.1, 1.0, 1e3, 1e300, math.inf]
    for _ in range(300):
        measured = rng.choice(values, 3) * rng.choice([-1.0, 1.0], 3)
        torque, memory = call(controller.law, memory, *measured.tolist())
        assert abs(torque) <= TORQUE_LIMIT
        assert np.isfinite(memory).all()


def kept_torque(torque, theta, theta_dot):
    """What remains of a torque of the gait, where nothing moves within the period of the law."""
    law = predictive_law(dt=1e-15, guard_from=1e6, phi_000=torque / TORQUE_LIMIT)
    estimate = (1.0, theta, theta_dot, X_DOT, 0.0, NOMINAL.M, NOMINAL.mu, 0.0)
    kept, _ = call(law, (*estimate, *(0.0,) * LATENCY), theta, theta_dot)
    return kept


def lightest_normal_force(theta, theta_dot, torque):
    plant = NOMINAL.plant(M=LIGHTEST, mu=0.0)
    return dynamics.accelerations(theta, theta_dot, 0.1, 1.0, torque, plant)[2]


def test_a_torque_that_would_lift_the_lightest_platform_is_reduced():
    least = CONTACT_MARGIN * (LIGHTEST + NOMINAL.m) * NOMINAL.g
    reduced = 0
    for theta, theta_dot, torque in itertools.product(
        (-1.0, -0.5, 0.5, 1.0), (-8.0, 0.0, 8.0), (-1.5, 0.5, 1.5)
    ):
        kept = kept_torque(torque, theta, theta_dot)
        if lightest_normal_force(theta, theta_dot, torque) >= least:
            assert kept == pytest.approx(torque)
        elif kept != pytest.approx(torque):
            reduced += 1
            normal = lightest_normal_force(theta, theta_dot, kept)
            assert normal == pytest.approx(least, rel=1e-9) or kept == 0.0
    assert reduced > 0


def test_a_torque_that_does_not_change_the_contact_is_kept():
    assert kept_torque(1.5, 0.0, 20.0) == 1.5
