"""What follows from the options of an environment: the core describes it
(`capsule_gym/core/step/contract.hpp`).
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from capsule_gym.checks import require
from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.core import _core
from capsule_gym.core.layout import Description, Settings
from capsule_gym.core.native import evaluate
from capsule_gym.envs.config import EnvConfig
from capsule_gym.parameters import (
    CONSTANTS,
    DISTURBANCES,
    NOMINAL,
    SENSORS,
    Capsule,
    Disturbances,
    Randomization,
)
from capsule_gym.tasks.registry import find_task

DEFAULTS = EnvConfig()
SPEED = find_task(DEFAULTS.task)

# Replaces a missing controller.
NO_CONTROLLER = Controller("none", CoreLaw("none"), np.zeros((1, 2)))
# Options that are numbers and have the same names in the core.
NUMBERS = (
    "torque_limit",
    "residual_limit",
    "total_torque",
    "control_dt",
    "physics_dt",
    "energy_weight",
    "termination_penalty",
    "observe_parameters",
    "observe_estimates",
    "stack_size",
    "goal_env",
    "initial_noise",
)
# The half of the disc of this radius that lies to the left of the imaginary axis is in the region
# of stability of the classical Runge-Kutta method (Hairer and Wanner, Solving Ordinary Differential
# Equations II, Sect. IV.2).
STABLE = 2.6


def describe(options: EnvConfig, controller: Controller | None) -> Description:
    """The settings of the step, the layout, the entries of the observation and the draws, without
    checks.

    Args:
        options: options of the environment.
        controller: the law inside the step. Entries depend only on whether there is one.
    """
    return _core.describe(core_options(options, controller))


def core_options(options: EnvConfig, controller: Controller | None) -> dict[str, float | None]:
    """The options by the names of the core, `_core.OPTIONS`; those that are not given are missing
    or None.
    """
    task = find_task(options.task)
    given: dict[str, float | None] = {name: getattr(options, name) for name in NUMBERS}
    given["task"] = task.number
    if task.draw_range is not None:
        given["task_low"], given["task_high"] = task.draw_range
    if options.initial_range is not None:
        given["initial_theta"], given["initial_theta_dot"] = options.initial_range
    return {
        **given,
        **controller_options(controller),
        **plant_options(options.capsule or NOMINAL, Randomization.named(options.randomization)),
        **disturbance_options(Disturbances.named(options.disturbances)),
    }


def controller_options(controller: Controller | None) -> dict[str, float | None]:
    """The options of the core that follow from the controller."""
    acting = controller or NO_CONTROLLER
    return {
        "controller": controller is not None,
        "law_dt": acting.dt,
        "memory_size": len(acting.memory),
        "reference_size": acting.reference.shape[1],
    }


def plant_options(capsule: Capsule, randomization: Randomization) -> dict[str, float | None]:
    """The constants of the plant and the ranges from which episodes draw them, as options of the
    core.
    """
    given: dict[str, float | None] = {
        "paper_normal_force": capsule.normal_force == "paper",
        "log_mu": randomization.log_mu,
    }
    for name in ("M", "mu", *CONSTANTS):
        given[name] = getattr(capsule, name)
        drawn = getattr(randomization, name)
        if drawn is not None:
            given[f"{name}_low"], given[f"{name}_high"] = drawn
    return given


def disturbance_options(disturbances: Disturbances | None) -> dict[str, float | None]:
    """The disturbances as options of the core; plants that vary draw those of an ideal environment,
    too.
    """
    found = disturbances or Disturbances()
    given: dict[str, float | None] = {
        "disturbed": disturbances is not None,
        "law_observes": found.controls != "agent",
        "agent_observes": found.controls != "law",
        "stick_threshold": found.stick_threshold,
        "x_noise": found.x_noise,
    }
    for name in SENSORS:
        given[f"with_{name}"] = name not in found.unmeasured
    for name in DISTURBANCES:
        low, high = ends(getattr(found, name))
        given[f"disturbances_{name}_low"] = low
        given[f"disturbances_{name}_high"] = high
    return given


def ends(value: float | tuple[float, float]) -> tuple[float, float]:
    """The ends of a range; a number is both ends of its range."""
    return value if isinstance(value, tuple) else (value, value)


def check_periods(options: EnvConfig, settings: Settings, *, law: bool) -> None:
    """Raises a ValueError if the steps of integrator, law and agent do not divide each other, or
    are too many.
    """
    dt = settings.physics_dt
    accepted = f"at most {_core.MOST_SUBSTEPS} times physics_dt={dt!r} s"
    require(
        options.control_dt / dt <= _core.MOST_SUBSTEPS, "control_dt", accepted, options.control_dt
    )
    law_name, step_name = (
        ("the law's step", "the controller's dt") if law else ("control_dt", "physics_dt")
    )
    _check_division(law_name, settings.law_dt, "physics_dt", dt, settings.physics_steps)
    _check_division(
        "control_dt", options.control_dt, step_name, settings.law_dt, settings.law_steps
    )


def _check_division(name: str, whole: float, part_name: str, part: float, count: float) -> None:
    """Raises a ValueError if `part` does not fit `count` times into `whole`, both in seconds."""
    fits = 1 <= count <= _core.MOST_SUBSTEPS and abs(count * part - whole) <= 1e-9 * whole
    require(
        fits,
        part_name,
        f"{name}={whole!r} s over a whole number, at most {_core.MOST_SUBSTEPS}",
        part,
    )


def check_step(capsule: Capsule, M: float, mu: float, settings: Settings) -> None:
    """Raises a ValueError for a plant, with its M in kg and mu, that is too stiff for the
    integrator's step.
    """
    h, rate = settings.physics_dt, capsule.fastest_rate(M, mu)
    if rate * h <= STABLE:
        return
    held, longest = settings.physics_steps * h, STABLE / rate
    enough = held * rate / STABLE * (1.0 + 1e-9)
    fits = enough * settings.law_steps < _core.MOST_SUBSTEPS
    would_do = f"physics_dt={held / math.ceil(enough)!r} would do" if fits else "no step would do"
    raise ValueError(
        f"physics_dt must be at most {longest:.4g} s for this capsule with M={M:.6g} kg and mu={mu:.6g}, whose fastest "
        f"rate is {rate:.4g} 1/s: beyond {STABLE} / rate the integrator is unstable; {would_do}, got {h!r} s"
    )


@lru_cache(maxsize=16)
def _plant_draws(randomization: Randomization, capsule: Capsule) -> np.ndarray:
    """The lines of the draw table for M and mu."""
    description = describe(EnvConfig(randomization=randomization, capsule=capsule), None)
    last = description.layout.task_draws
    return np.array(description.draws[last - 2 : last])


def draw_plant(
    randomization: Randomization, capsule: Capsule, rng: np.random.Generator
) -> tuple[float, float]:
    """Draws M in kg and mu as an episode does."""
    *_, low, width, distribution = _plant_draws(randomization, capsule).T
    M, mu = evaluate("number_at", rng.random(2), low, width, distribution)[0].tolist()
    return M, mu


def entries_of(options: EnvConfig) -> dict[str, tuple[float, float]]:
    """The entries of the observation in order, each with its bounds; those of n steps ago end with
    their number.

    The controller of the options is not needed, and not imported.
    """
    description = describe(options, None if options.controller is None else NO_CONTROLLER)
    return {name: (low, high) for name, low, high in description.entries}


def as_arrays(description: Description) -> dict[str, Any]:
    """The description as the arrays that the core's `Batch` holds."""
    return {
        "settings": np.array(description.settings, np.float64),
        "layout": np.array(description.layout, np.int64),
        "draw_table": np.array(description.draws, np.float64),
    }
