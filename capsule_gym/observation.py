"""The observation: its entries and their bounds. The core writes it (`capsule_gym/core/step.hpp`)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from capsule_gym._core import THETA_DOT_BOUND, X_DOT_BOUND
from capsule_gym.parameters import Capsule, Randomization
from capsule_gym.task import THETA_LIMIT

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
    capsule: Capsule,
    randomization: Randomization,
    torque_limit: float,
    task_entries: dict[str, tuple[float, float]],
    names: Iterable[str],
    stack_size: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest observation, float32, of the entries `names`; the torque limit is in N m."""
    largest_M, largest_mu = parameter_bounds(capsule, randomization)
    angle, rate = (-THETA_LIMIT, THETA_LIMIT), (-THETA_DOT_BOUND, THETA_DOT_BOUND)
    bounds = {
        **{"theta": angle, "theta_dot": rate, "x_dot": (-X_DOT_BOUND, X_DOT_BOUND), "stick": (0.0, 1.0)},
        **{"last_action": (-1.0, 1.0), "theta_d": angle, "theta_d_dot": rate},
        **{"sin_phase": (-1.0, 1.0), "cos_phase": (-1.0, 1.0), "law_torque": (-torque_limit, torque_limit)},
        **{"M": (0.0, largest_M), "mu": (0.0, largest_mu)},
        **task_entries,
    }
    low, high = np.array([bounds[name] for name in names], np.float32).T
    return np.tile(low, stack_size), np.tile(high, stack_size)


# Inputs of a policy from the online filter (`capsule_gym/core/identification.hpp`): M, log(mu), and the standard
# deviations of both.
ESTIMATES = ("M_estimate", "log_mu_estimate", "M_deviation", "log_mu_deviation")
