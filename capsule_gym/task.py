"""The task, once for every environment: reward, termination and the metrics of an episode.

The functions of a single time step are plain scalar functions; `capsule_gym.kernels` compiles them into the step.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

ENV_ID = "CapsuleStickSlip-v0"
EPISODE_STEPS = 1650
CONTROL_DT = 0.02
HORIZON = EPISODE_STEPS * CONTROL_DT
TORQUE_LIMIT = 1.5
# In centimetres of progress: a joule, and a failure.
ENERGY_WEIGHT = 0.1
TERMINATION_PENALTY = 10.0
THETA_LIMIT = math.pi / 2.0
START_THETA = -math.pi / 3.0
# What a reset may set: |theta| below THETA_LIMIT, and up to this |theta_dot| (rad/s), |x| (m) and |x_dot| (m/s).
LARGEST_STATE = (THETA_LIMIT, 1e3, 1e6, 1e3)
# |theta_dot| + |x_dot| (rad/s, m/s) at an event, such as the end of an episode, beyond which the motion counts as lost.
RATE_LIMIT = 1e4


class Termination(IntEnum):
    """Why an episode ended before its time."""

    none = 0
    pendulum = 1
    contact = 2
    diverged = 3


class Metrics(NamedTuple):
    """The metrics of an episode, each of shape (environments,), float64."""

    mean_speed: np.ndarray  # cm/s
    cost_of_transport: np.ndarray  # energy over weight and distance; infinite without forward progress
    peak_torque: np.ndarray  # N m
    rms_torque: np.ndarray  # N m
    backward_ratio: np.ndarray  # travel backwards over travel forwards; infinite with the former alone, 0 at rest
    stuck_fraction: np.ndarray  # share of the time in stick
    smallest_normal_ratio: np.ndarray  # smallest N / ((M + m) g)
    largest_theta: np.ndarray  # largest |theta|, rad
    largest_theta_dot: np.ndarray  # largest |theta_dot|, rad/s
    distance: np.ndarray  # m
    energy: np.ndarray  # integral of |u theta_dot|, J
    duration: np.ndarray  # s
    failed: np.ndarray  # 1 where the episode terminated, else 0


METRICS = Metrics._fields


def reward_terms(
    progress: float,  # displacement of the platform, m
    energy: float,  # integral of |u theta_dot|, J
    terminated: bool,  # whether the episode failed in this step
    energy_weight: float,  # cost of a joule, in centimetres
    termination_penalty: float,  # cost of a failure, in centimetres
) -> tuple[float, float, float]:
    """The three terms of the reward of one agent step.

    Returns:
        Centimetres of forward progress, the cost of the energy (<= 0), the cost of a failure (<= 0).
    """
    return 100.0 * progress, -energy_weight * energy, -termination_penalty if terminated else 0.0


def termination(theta: float, normal_force: float) -> int:
    """`Termination` as an integer: the ball meets the platform, or the platform leaves the floor."""
    if abs(theta) >= THETA_LIMIT:
        return 1
    if normal_force <= 0.0:
        return 2
    return 0


def continues(theta: float, normal_force: float) -> bool:
    """Whether `termination` is 0 and both are numbers.

    That finds every step that has left the numbers: with the sizes that a plant and a torque may have, accelerations
    that overflow grow so fast from stage to stage that none cancels another in theta. A comparison more would be a
    tenth of the kernel's time.
    """
    return abs(theta) < THETA_LIMIT and normal_force > 0.0


def bounded(theta_dot: float, x_dot: float) -> bool:
    """Whether the rates are those of a motion that the integrator resolves; NaN is not."""
    return abs(theta_dot) + abs(x_dot) <= RATE_LIMIT
