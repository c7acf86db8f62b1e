"""The observation: its entries and their bounds. The core writes it (`capsule_gym/core/step/observation.hpp`)."""

from capsule_gym.core import _core
from capsule_gym.envs.config import EnvConfig
from capsule_gym.parameters import NOMINAL, Capsule, Randomization
from capsule_gym.tasks.registry import find_task
from capsule_gym.tasks.task import THETA_LIMIT

# Bounds of the observed M, in masses of the capsule's platform, and of mu; wider ranges extend them.
M_BOUND = 4.0
MU_BOUND = 1.0


def parameter_bounds(capsule: Capsule, randomization: Randomization) -> tuple[float, float]:
    """The largest M in kg and the largest mu that a reset may set in an environment that observes them."""
    # Margin for the rounding of a draw, and of the observation to float32.
    room = 1.0 + 1e-6
    heaviest = randomization.M[1] if randomization.M else capsule.M
    roughest = randomization.mu[1] if randomization.mu else capsule.mu
    return max(M_BOUND * capsule.M, room * heaviest), max(MU_BOUND, room * roughest)


def observation_entries(options: EnvConfig) -> dict[str, tuple[float, float]]:
    """The entries of the observation in order, each with its bounds; those of n steps ago end with their number."""
    angle, rate, unit = (-THETA_LIMIT, THETA_LIMIT), (-_core.THETA_DOT_BOUND, _core.THETA_DOT_BOUND), (-1.0, 1.0)
    entries = {"theta": angle, "theta_dot": rate, "x_dot": (-_core.X_DOT_BOUND, _core.X_DOT_BOUND), "stick": (0.0, 1.0)}
    entries["last_action"] = unit
    if options.controller is not None:
        entries |= {"theta_d": angle, "theta_d_dot": rate, "sin_phase": unit, "cos_phase": unit}
        entries["law_torque"] = -options.torque_limit, options.torque_limit
    if options.observe_parameters:
        bounds = parameter_bounds(options.capsule or NOMINAL, Randomization.named(options.randomization))
        entries |= {"M": (0.0, bounds[0]), "mu": (0.0, bounds[1])}
    if options.observe_estimates:
        # From the online estimator (`capsule_gym/core/estimator.hpp`).
        entries |= _core.ESTIMATES
    if not options.goal_env:
        entries |= find_task(options.task).entries
    return entries | {f"{name} {n}": entries[name] for n in range(1, options.stack_size) for name in entries}
