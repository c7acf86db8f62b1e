"""The observation: its entries, their bounds, how the step writes them, and how M and mu are identified from it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from capsule_gym.compilation import inlined
from capsule_gym.elementary import clip, exp, sincos
from capsule_gym.parameters import Capsule, Randomization
from capsule_gym.task import THETA_LIMIT

# Bounds of the observation, which is clipped to them. Full torque switched in the worst phase gives 13 rad/s and
# 1.2 m/s on the capsule of the paper; the rest is room for other capsules.
THETA_DOT_BOUND = 20.0
X_DOT_BOUND = 2.0
# Bounds of the observed M, in masses of the capsule's platform, and of mu; wider ranges extend them.
M_BOUND = 4.0
MU_BOUND = 1.0


def observation_names(
    with_reference: bool, with_parameters: bool, task_entries: Iterable[str] = (), stack_size: int = 1
) -> tuple[str, ...]:
    """The entries of the observation, in order; those of n steps ago end with their number."""
    reference = ("theta_d", "theta_d_dot", "sin_phase", "cos_phase", "law_torque") if with_reference else ()
    parameters = ("M", "mu") if with_parameters else ()
    names = ("theta", "theta_dot", "x_dot", "stick", "last_action", *reference, *parameters, *task_entries)
    return names + tuple(f"{name} {n}" for n in range(1, stack_size) for name in names)


def parameter_bounds(capsule: Capsule, randomization: Randomization) -> tuple[float, float]:
    """The largest M in kg and the largest mu that a reset may set in an environment that observes them."""
    # Margin for the rounding of a draw, and of the observation to float32.
    room = 1.0 + 1e-6
    heaviest = randomization.M[1] if randomization.M else capsule.M
    roughest = randomization.mu[1] if randomization.mu else capsule.mu
    return max(M_BOUND * capsule.M, room * heaviest), max(MU_BOUND, room * roughest)


def observation_bounds(
    with_reference: bool,  # whether a control law runs inside the step
    with_parameters: bool,  # whether M and mu are observed
    capsule: Capsule,
    randomization: Randomization,  # where M and mu of an episode come from
    torque_limit: float,  # N m
    task_entries: dict[str, tuple[float, float]],  # bounds of the task's entries
    stack_size: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest observation, float32."""
    largest_M, largest_mu = parameter_bounds(capsule, randomization)
    bounds = {
        "theta": (-THETA_LIMIT, THETA_LIMIT),
        "theta_dot": (-THETA_DOT_BOUND, THETA_DOT_BOUND),
        "x_dot": (-X_DOT_BOUND, X_DOT_BOUND),
        "stick": (0.0, 1.0),
        "last_action": (-1.0, 1.0),
        "theta_d": (-THETA_LIMIT, THETA_LIMIT),
        "theta_d_dot": (-THETA_DOT_BOUND, THETA_DOT_BOUND),
        "sin_phase": (-1.0, 1.0),
        "cos_phase": (-1.0, 1.0),
        "law_torque": (-torque_limit, torque_limit),
        "M": (0.0, largest_M),
        "mu": (0.0, largest_mu),
        **task_entries,
    }
    names = observation_names(with_reference, with_parameters, task_entries)
    low, high = np.array([bounds[name] for name in names], np.float32).T
    return np.tile(low, stack_size), np.tile(high, stack_size)


@inlined
def write_observation(
    out: np.ndarray,  # shape (entries,), float32, written in the order of `observation_names`
    state: tuple[float, float, float],  # theta (rad), theta_dot (rad/s), x_dot (m/s)
    stick_threshold: float,  # largest |x_dot| that counts as stick, m/s
    last_action: float,  # in [-1, 1]
    reference: tuple[float, float, float],  # theta_d (rad), theta_d_dot (rad/s), phase of the cycle in [0, 1)
    law_torque: float,  # torque of the law at this instant, clipped to the torque limit, N m
    parameters: tuple[float, float],  # M (kg) and mu
    with_reference: bool,  # whether the entries of the law are included
    with_parameters: bool,  # whether M and mu are included
) -> None:
    """Writes the observation of one environment."""
    theta, theta_dot, x_dot = state
    out[0] = clip(theta, THETA_LIMIT)
    out[1] = clip(theta_dot, THETA_DOT_BOUND)
    out[2] = clip(x_dot, X_DOT_BOUND)
    out[3] = 1.0 if abs(x_dot) <= stick_threshold else 0.0
    out[4] = last_action
    next_entry = 5
    if with_reference:
        theta_d, theta_d_dot, phase = reference
        out[5] = clip(theta_d, THETA_LIMIT)
        out[6] = clip(theta_d_dot, THETA_DOT_BOUND)
        out[7], out[8] = sincos(2.0 * math.pi * phase)
        out[9] = law_torque
        next_entry = 10
    if with_parameters:
        out[next_entry] = parameters[0]
        out[next_entry + 1] = parameters[1]


# Identification of M and mu: see `identify`.
# Prior of M in kg and log(mu): a little wider than `randomization="wide"`.
PRIOR_M, PRIOR_LOG_MU = 0.55, -3.25
DEVIATION_M, DEVIATION_LOG_MU = 0.2, 1.5
# The estimates' range.
LOW_M, HIGH_M, LOW_LOG_MU, HIGH_LOG_MU = 0.15, 2.0, -7.0, 0.0
# Standard deviation of a velocity's difference, m/s: far above float32's rounding, so that the first pairs do not
# overshoot.
NOISE = 1e-3
# Gauss-Newton steps for a pair, share of the information that remains after it, and deviations that contradict.
ITERATIONS, RETAINED, DOUBT = 3, 0.95, 5.0
# m/s: below this speed the platform may have stuck in between.
SLOWEST = 0.02

# Cells of the memory: 1.0 once begun; M, log(mu) and their covariance; cos(theta) theta', sin(theta) theta' and x' of
# the last observation. All 0.0 at the start of an episode.
CELLS = 9
# Inputs of a policy from this filter: M, log(mu), and the standard deviations of both.
ESTIMATES = ("M_estimate", "log_mu_estimate", "M_deviation", "log_mu_deviation")

Memory = tuple[float, float, float, float, float, float, float, float, float]


@inlined
def identify(
    memory: Memory,  # see `CELLS`
    theta: float,  # rad
    theta_dot: float,  # rad/s
    x_dot: float,  # m/s
    m: float,  # mass of the ball, kg
    l: float,  # length of the pendulum, m
    g: float,  # gravitational acceleration, m/s^2
    dt: float,  # time between the observations, s
) -> Memory:
    """Updates the online estimate of M and mu with one observation.

    While the platform slips in one direction, the balance of momentum between two observations is exact for any torque.
    With q = m l / (M + m) and s the sign of x',

        d x' = q d(cos(theta) theta') - mu s (g dt - q d(sin(theta) theta'))

    where d is the difference of the two observations. An iterated extended Kalman filter estimates M and log(mu) with
    their covariance from such pairs of observations. It ignores pairs in which the platform sticks or changes its
    direction. The covariance grows a little with every pair and is reset where a pair contradicts the estimate, since M
    and mu can change during an episode. For a `Capsule` with another friction coefficient backwards, or with the
    paper's normal force, the balance is approximate. The filter is part of the policy, not of the environment.
    """
    begun, M, log_mu, P_MM, P_Mf, P_ff, last_across, last_along, last_x_dot = memory
    sin, cos = sincos(theta)
    across, along = cos * theta_dot, sin * theta_dot
    if begun == 0.0:
        return (
            *(1.0, PRIOR_M, PRIOR_LOG_MU, DEVIATION_M * DEVIATION_M, 0.0, DEVIATION_LOG_MU * DEVIATION_LOG_MU),
            *(across, along, x_dot),
        )
    if x_dot * last_x_dot > 0.0 and min(abs(x_dot), abs(last_x_dot)) > SLOWEST:
        s = 1.0 if x_dot > 0.0 else -1.0
        d_across, d_along, change = across - last_across, along - last_along, x_dot - last_x_dot
        before_M, before_log_mu = M, log_mu
        gain_M = gain_f = to_M = to_f = 0.0
        for iteration in range(ITERATIONS):
            # The change of x' by the balance of momentum, and its slopes over M and log(mu).
            q, mu = m * l / (M + m), exp(log_mu)
            friction = mu * s * (g * dt - q * d_along)
            slope_M, slope_f = -q / (M + m) * (d_across + mu * s * d_along), -friction
            predicted = q * d_across - friction
            surprise = change - predicted - slope_M * (before_M - M) - slope_f * (before_log_mu - log_mu)
            to_M, to_f = P_MM * slope_M + P_Mf * slope_f, P_Mf * slope_M + P_ff * slope_f
            variance = slope_M * to_M + slope_f * to_f + NOISE * NOISE
            if iteration == 0 and surprise * surprise > DOUBT * DOUBT * variance:
                P_MM, P_Mf, P_ff = DEVIATION_M * DEVIATION_M, 0.0, DEVIATION_LOG_MU * DEVIATION_LOG_MU
                to_M, to_f = P_MM * slope_M, P_ff * slope_f
                variance = slope_M * to_M + slope_f * to_f + NOISE * NOISE
            gain_M, gain_f = to_M / variance, to_f / variance
            M = min(HIGH_M, max(LOW_M, before_M + gain_M * surprise))
            log_mu = min(HIGH_LOG_MU, max(LOW_LOG_MU, before_log_mu + gain_f * surprise))
        P_MM, P_Mf, P_ff = P_MM - gain_M * to_M, P_Mf - gain_M * to_f, P_ff - gain_f * to_f
        # Never less certain than the prior.
        fading = max(RETAINED, P_MM / (DEVIATION_M * DEVIATION_M), P_ff / (DEVIATION_LOG_MU * DEVIATION_LOG_MU))
        P_MM, P_Mf, P_ff = P_MM / fading, P_Mf / fading, P_ff / fading
    return begun, M, log_mu, P_MM, P_Mf, P_ff, across, along, x_dot


@inlined
def estimates(memory: Memory) -> tuple[float, float, float, float]:
    """The estimates that `ESTIMATES` names."""
    _, M, log_mu, P_MM, _, P_ff, _, _, _ = memory
    return M, log_mu, math.sqrt(max(0.0, P_MM)), math.sqrt(max(0.0, P_ff))
