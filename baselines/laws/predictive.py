"""Control laws for late, noisy measurements and a lagging motor: an observer and a predictor around other laws.

The sensors show the state of LATENCY calls ago. An observer with fixed gains estimates that state. The nominal model
predicts from it, with the torques that the law has returned since, the state at which the next torque acts. The
friction coefficient, the mass of the platform and the bias of the measured x_dot are estimated by gradient descent on
the squared error of x_dot. The position is not measured.
"""

from __future__ import annotations

from typing import NamedTuple

from baselines.laws.adaptive import adaptive, constants_of
from baselines.laws.adaptive_terms import adaptive_step
from baselines.laws.gains import PUBLISHED, REGULARISED
from baselines.laws.gait import LIGHTEST, NO_REFERENCE, guarded_torque, known_parameters
from capsule_gym.compilation import inlined
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller, Law
from capsule_gym.dynamics import pressed_accelerations
from capsule_gym.elementary import clip, sincos
from capsule_gym.observation import HIGH_M, LOW_M, THETA_DOT_BOUND, X_DOT_BOUND
from capsule_gym.parameters import NOMINAL, Plant
from capsule_gym.task import THETA_LIMIT, TORQUE_LIMIT

# Assumed: calls from a measurement to its torque, the time constant of the motor in s, and its friction in N m.
LATENCY, LAG, MOTOR_FRICTION = 10, 0.005, 0.05
# Speeds below which the model's friction falls linearly to 0: of the motor in rad/s, of the floor in m/s.
MOTOR_WIDTH, FLOOR_WIDTH = 0.2, 0.005
# Share of a measurement's error by which a call corrects the estimate.
GAIN_THETA, GAIN_THETA_DOT, GAIN_X_DOT = 0.005, 0.05, 0.02
# Rates of learning per call: of log(mu) in s/m, of log(M) in s^2/m, and of the bias of x_dot as a share of the error.
RATE_MU, RATE_M, RATE_BIAS = 0.02, 1e-3, 1e-4
# The friction coefficient at first, the range of its estimates, and the largest bias of x_dot, m/s.
FIRST_MU, LOW_MU, HIGH_MU = 0.02, 0.0025, 1.0
LARGEST_BIAS = 0.05
# Added to the predicted x_dot, m/s: the gait becomes slow if the estimate is too low, but hardly if it is too high.
X_DOT_MARGIN = 0.004
# Smallest normal force, as a share of the weight with the lightest platform.
CONTACT_MARGIN = 0.1

PLANT, LIGHTEST_PLANT = NOMINAL.plant(), NOMINAL.plant(M=LIGHTEST, mu=0.0)
# Calls per Euler step of the predictor, whose torques are averaged.
STRIDE = 3


class Estimate(NamedTuple):
    """The observer's estimate of the state LATENCY calls ago, before the measurement of that time.

    Attributes:
        begun: 1.0 after the first measurement.
        theta: rad.
        theta_dot: rad/s.
        x_dot: m/s.
        motor: torque of the motor after its lag, N m.
        M: mass of the platform, kg.
        mu: friction coefficient.
        bias: bias of the measured x_dot, m/s.
    """

    begun: float
    theta: float
    theta_dot: float
    x_dot: float
    motor: float
    M: float
    mu: float
    bias: float


CELLS = len(Estimate._fields)
# The estimate, and the torques of the last LATENCY calls, the oldest first.
MEMORY = (0.0, 0.0, 0.0, 0.0, 0.0, NOMINAL.M, FIRST_MU, 0.0, *(0.0,) * LATENCY)
SIZE = len(MEMORY)


@inlined
def model_step(estimate: Estimate, torque: float, h: float) -> Estimate:
    """One Euler step of h seconds of the nominal model with the estimated M and mu; implicit for the motor's lag."""
    begun, theta, theta_dot, x_dot, motor, M, mu, bias = estimate
    motor += h / (LAG + h) * (torque - motor)
    u = motor - MOTOR_FRICTION * clip(theta_dot / MOTOR_WIDTH, 1.0)
    p = Plant(M, mu, PLANT.m / (M + PLANT.m), *PLANT[3:])
    friction = mu * clip(x_dot / FLOOR_WIDTH, 1.0)
    theta_ddot, x_ddot, _ = pressed_accelerations(theta, theta_dot, x_dot, 1.0, friction, u, p)
    return Estimate(
        begun,
        theta + h * (theta_dot + 0.5 * h * theta_ddot),
        theta_dot + h * theta_ddot,
        x_dot + h * x_ddot,
        motor,
        M,
        mu,
        bias,
    )


@inlined
def correct(estimate: Estimate, theta: float, theta_dot: float, x_dot: float) -> Estimate:
    """The estimate after a measurement; the first measurement is used unchanged.

    If the measured x_dot is above its estimate while the platform slides forwards, friction is smaller than estimated.
    If it is above while the pendulum swings forwards, the platform is lighter than estimated.
    """
    theta, theta_dot, x_dot = clip(theta, THETA_LIMIT), clip(theta_dot, THETA_DOT_BOUND), clip(x_dot, X_DOT_BOUND)
    first = estimate.begun == 0.0
    before_theta = theta if first else clip(estimate.theta, THETA_LIMIT)
    before_theta_dot = theta_dot if first else clip(estimate.theta_dot, THETA_DOT_BOUND)
    before_x_dot = x_dot if first else clip(estimate.x_dot, X_DOT_BOUND)
    error = x_dot - estimate.bias - before_x_dot
    sliding = clip(before_x_dot / FLOOR_WIDTH, 1.0)
    swinging = sincos(before_theta)[1] * before_theta_dot
    return Estimate(
        1.0,
        before_theta + GAIN_THETA * (theta - before_theta),
        before_theta_dot + GAIN_THETA_DOT * (theta_dot - before_theta_dot),
        before_x_dot + GAIN_X_DOT * error,
        estimate.motor,
        min(HIGH_M, max(LOW_M, estimate.M * (1.0 - RATE_M * swinging * error))),
        min(HIGH_MU, max(LOW_MU, estimate.mu * (1.0 - RATE_MU * sliding * error))),
        clip(estimate.bias + RATE_BIAS * error, LARGEST_BIAS),
    )


@inlined
def predict(
    memory: tuple[float, ...], theta: float, theta_dot: float, x_dot: float
) -> tuple[Estimate, tuple[float, ...]]:
    """Corrects the estimate by a measurement of LATENCY calls ago and predicts the present; memory as `MEMORY`.

    Returns:
        The estimate of the present state, and the memory of the next call without its last cell, the returned torque.
    """
    queue = memory[CELLS:]
    begun, then, rate, velocity, motor, M, mu, bias = memory[:CELLS]
    corrected = correct(Estimate(begun, then, rate, velocity, motor, M, mu, bias), theta, theta_dot, x_dot)
    present = model_step(corrected, queue[0], LAW_DT)
    begun, then, rate, velocity, motor, M, mu, bias = present
    kept = (begun, then, rate, velocity, motor, M, mu, bias, *queue[1:])
    for i in range(1, LATENCY, STRIDE):
        present = model_step(present, (queue[i] + queue[i + 1] + queue[i + 2]) / STRIDE, STRIDE * LAW_DT)
    return present, kept


@inlined
def keep_contact(torque: float, theta: float, theta_dot: float) -> float:
    """Reduces a torque, at most to 0, if the normal force of the lightest platform would become too small.

    The normal force is linear in the torque.
    """
    p = LIGHTEST_PLANT
    free = pressed_accelerations(theta, theta_dot, 0.0, 1.0, 0.0, 0.0, p)[2]
    per_torque = pressed_accelerations(theta, theta_dot, 0.0, 1.0, 0.0, 1.0, p)[2] - free
    needed = CONTACT_MARGIN * (p.M + p.m) * p.g - free
    # Near the upright the torque does not act on the normal force.
    if per_torque > 1e-6:
        return max(torque, min(0.0, needed / per_torque))
    if per_torque < -1e-6:
        return min(torque, max(0.0, needed / per_torque))
    return torque


def predictive_gait_law(parameters: tuple[float, ...]) -> Law:
    """The guarded gait on the predicted state; its parameters in the order of `baselines.laws.gait.PARAMETERS`."""

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        now, kept = predict(memory, theta, theta_dot, x_dot)
        torque = guarded_torque(now.theta, now.theta_dot, now.x_dot + X_DOT_MARGIN, parameters)
        torque = clip(keep_contact(torque, now.theta, now.theta_dot), TORQUE_LIMIT)
        return torque, (*kept, torque)

    return law


def gait_predictive() -> Controller:
    """The gait on the state of the observer and predictor."""
    return Controller("gait_predictive", predictive_gait_law(known_parameters()), NO_REFERENCE, memory=MEMORY)


def adaptive_predictive() -> Controller:
    """The regularised adaptive law (39) on the state of the observer and predictor.

    Its x is the integral of the predicted x_dot.
    """
    base = adaptive()
    constants = constants_of(PUBLISHED, REGULARISED, PLANT, base.reference, base.dt)

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        now, kept = predict(memory[:SIZE], theta, theta_dot, x_dot)
        position, own = memory[-1], memory[SIZE:-1]
        torque, renewed = adaptive_step(now.theta, now.theta_dot, position, now.x_dot, own, reference, constants)
        torque = clip(torque, TORQUE_LIMIT)
        return torque, (*kept, torque, *renewed, position + LAW_DT * now.x_dot)

    return Controller("adaptive_predictive", law, base.reference, (*MEMORY, *base.memory, 0.0), base.dt)
