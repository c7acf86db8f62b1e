"""The observation: its entries and their bounds. The core writes it (`capsule_gym/core/step.hpp`)."""

from __future__ import annotations

import numpy as np

from capsule_gym._core import ESTIMATES, THETA_DOT_BOUND, X_DOT_BOUND
from capsule_gym.config import EnvConfig, find_task
from capsule_gym.parameters import NOMINAL, Capsule, Randomization
from capsule_gym.task import THETA_LIMIT

# Bounds of the observed M, in masses of the capsule's platform, and of mu; wider ranges extend them.
M_BOUND = 4.0
MU_BOUND = 1.0


def observation_names(options: EnvConfig) -> tuple[str, ...]:
    """The entries of an environment's observation, in order; those of n steps ago end with their number."""
    names = ["theta", "theta_dot", "x_dot", "stick", "last_action"]
    if options.controller is not None:
        names += ["theta_d", "theta_d_dot", "sin_phase", "cos_phase", "law_torque"]
    names += ["M", "mu"] if options.observe_parameters else []
    # From the online filter (`capsule_gym/core/identification.hpp`): M, log(mu), and the standard deviations of both.
    names += ESTIMATES if options.observe_estimates else []
    names += [] if options.goal_env else find_task(options.task).entries
    return (*names, *(f"{name} {n}" for n in range(1, options.stack_size) for name in names))


def parameter_bounds(capsule: Capsule, randomization: Randomization) -> tuple[float, float]:
    """The largest M in kg and the largest mu that a reset may set in an environment that observes them."""
    # Margin for the rounding of a draw, and of the observation to float32.
    room = 1.0 + 1e-6
    heaviest = randomization.M[1] if randomization.M else capsule.M
    roughest = randomization.mu[1] if randomization.mu else capsule.mu
    return max(M_BOUND * capsule.M, room * heaviest), max(MU_BOUND, room * roughest)


def observation_bounds(options: EnvConfig) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest observation of an environment, float32."""
    largest_M, largest_mu = parameter_bounds(options.capsule or NOMINAL, Randomization.named(options.randomization))
    torque_limit = options.torque_limit
    angle, rate = (-THETA_LIMIT, THETA_LIMIT), (-THETA_DOT_BOUND, THETA_DOT_BOUND)
    bounds = {
        **{"theta": angle, "theta_dot": rate, "x_dot": (-X_DOT_BOUND, X_DOT_BOUND), "stick": (0.0, 1.0)},
        **{"last_action": (-1.0, 1.0), "theta_d": angle, "theta_d_dot": rate},
        **{"sin_phase": (-1.0, 1.0), "cos_phase": (-1.0, 1.0), "law_torque": (-torque_limit, torque_limit)},
        **{"M": (0.0, largest_M), "mu": (0.0, largest_mu)},
        **ESTIMATES,
        **find_task(options.task).entries,
    }
    names = observation_names(options)
    low, high = np.array([bounds[name.partition(" ")[0]] for name in names], np.float32).T
    return low, high
