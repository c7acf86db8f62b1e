"""The observation: the names and bounds of its entries, and how the compiled step writes them."""

from __future__ import annotations

import math

import numpy as np

from capsule_gym.compilation import inlined
from capsule_gym.elementary import clip, sincos
from capsule_gym.parameters import Capsule, Randomization
from capsule_gym.task import THETA_LIMIT

# Bounds of the observation, which is clipped to them. Full torque switched in the worst phase gives 13 rad/s and
# 1.2 m/s on the capsule of the paper; the rest is room for other capsules.
THETA_DOT_BOUND = 20.0
X_DOT_BOUND = 2.0
# Bounds of the observed M, in masses of the capsule's platform, and of mu; ranges that go further widen them.
M_BOUND = 4.0
MU_BOUND = 1.0

BASE_OBSERVATION = ("theta", "theta_dot", "x_dot", "stick", "last_action")
REFERENCE_OBSERVATION = ("theta_d", "theta_d_dot", "sin_phase", "cos_phase", "law_torque")
PARAMETER_OBSERVATION = ("M", "mu")


def observation_names(with_reference: bool, with_parameters: bool) -> tuple[str, ...]:
    """The entries of the observation, in order."""
    return (
        BASE_OBSERVATION
        + (REFERENCE_OBSERVATION if with_reference else ())
        + (PARAMETER_OBSERVATION if with_parameters else ())
    )


def parameter_bounds(capsule: Capsule, randomization: Randomization) -> tuple[float, float]:
    """The largest M in kg and the largest mu of an environment that shows them: what a reset may set.

    Args:
        capsule: the capsule of the environment.
        randomization: where M and mu of an episode come from.
    """
    # Room for the rounding of a draw, and of the observation to float32.
    room = 1.0 + 1e-6
    heaviest = randomization.M[1] if randomization.M else capsule.M
    roughest = randomization.mu[1] if randomization.mu else capsule.mu
    return max(M_BOUND * capsule.M, room * heaviest), max(MU_BOUND, room * roughest)


def observation_bounds(
    with_reference: bool, with_parameters: bool, capsule: Capsule, randomization: Randomization, torque_limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest observation, float32.

    Args:
        with_reference: whether a control law runs inside the step.
        with_parameters: whether M and mu are observed.
        capsule: the capsule of the environment, for the bounds of M and mu.
        randomization: where M and mu of an episode come from, for the same bounds.
        torque_limit: N m.
    """
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
    }
    low, high = np.array([bounds[name] for name in observation_names(with_reference, with_parameters)], np.float32).T
    return low.copy(), high.copy()


@inlined
def write_observation(
    out: np.ndarray,
    state: tuple[float, float, float],
    last_action: float,
    reference: tuple[float, float, float],
    law_torque: float,
    parameters: tuple[float, float],
    with_reference: bool,
    with_parameters: bool,
) -> None:
    """Writes the observation of one environment.

    Args:
        out: shape (entries,), float32, written in the order of `observation_names`.
        state: theta (rad), theta_dot (rad/s), x_dot (m/s).
        last_action: in [-1, 1].
        reference: theta_d (rad), theta_d_dot (rad/s), phase of the cycle in [0, 1).
        law_torque: the torque that the law returns at this instant, clipped to the torque limit, N m.
        parameters: M (kg) and mu.
        with_reference: whether the entries of the law are there.
        with_parameters: whether M and mu are.
    """
    theta, theta_dot, x_dot = state
    out[0] = clip(theta, THETA_LIMIT)
    out[1] = clip(theta_dot, THETA_DOT_BOUND)
    out[2] = clip(x_dot, X_DOT_BOUND)
    out[3] = 1.0 if x_dot == 0.0 else 0.0
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
