"""What the agent sees, written inside the compiled step. `capsule_gym.task` has the names and bounds of the entries."""

from __future__ import annotations

import math

import numpy as np

from capsule_gym import task
from capsule_gym.compilation import inlined
from capsule_gym.elementary import clip, sincos


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
        out: shape (entries,), float32, written in the order of `capsule_gym.task.observation_names`.
        state: theta (rad), theta_dot (rad/s), x_dot (m/s).
        last_action: in [-1, 1].
        reference: theta_d (rad), theta_d_dot (rad/s), phase of the cycle in [0, 1).
        law_torque: what the law asks for at this instant, clipped to the torque limit, N m.
        parameters: M (kg) and mu.
        with_reference: whether the entries of the law are there.
        with_parameters: whether M and mu are.
    """
    theta, theta_dot, x_dot = state
    out[0] = clip(theta, task.THETA_LIMIT)
    out[1] = clip(theta_dot, task.THETA_DOT_BOUND)
    out[2] = clip(x_dot, task.X_DOT_BOUND)
    out[3] = 1.0 if x_dot == 0.0 else 0.0
    out[4] = last_action
    next_entry = 5
    if with_reference:
        theta_d, theta_d_dot, phase = reference
        out[5] = clip(theta_d, task.THETA_LIMIT)
        out[6] = clip(theta_d_dot, task.THETA_DOT_BOUND)
        out[7], out[8] = sincos(2.0 * math.pi * phase)
        out[9] = law_torque
        next_entry = 10
    if with_parameters:
        out[next_entry] = parameters[0]
        out[next_entry + 1] = parameters[1]
