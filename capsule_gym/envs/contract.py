"""What follows from the options of an environment, and the checks of options together.

The core describes what follows (`capsule_gym/core/step/contract.hpp`).
"""

import math
from dataclasses import replace
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
from capsule_gym.tasks.task import Task

# The options by the names of the core, `_core.OPTIONS`; those not given are missing or None.
CoreOptions = dict[str, float | None]

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
    """The settings, layout, entries of the observation and draws of an environment, unchecked.

    Args:
        options: options of the environment.
        controller: the law inside the step. Entries depend only on whether there is one.
    """
    return _core.describe(core_options(options, controller))


def core_options(options: EnvConfig, controller: Controller | None) -> CoreOptions:
    """The options of an environment as options of the core."""
    task = find_task(options.task)
    given: CoreOptions = {name: getattr(options, name) for name in NUMBERS}
    given["task"] = task.number
    if task.draw_range is not None:
        given["task_low"], given["task_high"] = task.draw_range
    if options.initial_range is not None:
        given["initial_theta"], given["initial_theta_dot"] = options.initial_range
    given |= controller_options(controller)
    given |= plant_options(options.capsule or NOMINAL, Randomization.named(options.randomization))
    return given | disturbance_options(Disturbances.named(options.disturbances))


def controller_options(controller: Controller | None) -> CoreOptions:
    """The options of the core that follow from the controller."""
    acting = controller or NO_CONTROLLER
    return {
        "controller": controller is not None,
        "law_dt": acting.dt,
        "memory_size": len(acting.memory),
        "reference_size": acting.reference.shape[1],
    }


def plant_options(capsule: Capsule, randomization: Randomization) -> CoreOptions:
    """The constants of the plant, and the ranges of drawn ones, as options of the core."""
    given: CoreOptions = {
        "paper_normal_force": capsule.normal_force == "paper",
        "log_mu": randomization.log_mu,
    }
    for name in ("M", "mu", *CONSTANTS):
        given[name] = getattr(capsule, name)
        drawn = getattr(randomization, name)
        if drawn is not None:
            given[f"{name}_low"], given[f"{name}_high"] = drawn
    return given


def disturbance_options(disturbances: Disturbances | None) -> CoreOptions:
    """The disturbances as options of the core; varied plants draw those of an ideal environment."""
    found = disturbances or Disturbances()
    given: CoreOptions = {
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


def check_law_task(controller: Controller | None, task: Task) -> None:
    """Raises a ValueError if the law is for another task."""
    if controller is None or controller.task is None:
        return
    law_task = find_task(controller.task).name
    if law_task != task.name:
        raise ValueError(
            f"controller must be a law for the task {task.name!r} or for any, "
            f"got {controller.name!r}, which is for the task {law_task!r}"
        )


def check_options(options: EnvConfig, settings: Settings, *, law: bool) -> None:
    """Raises a ValueError if options contradict each other, or a plant is too stiff for the step.

    Args:
        options: options of the environment.
        settings: the settings that follow from them.
        law: whether a control law runs inside the step.
    """
    check_periods(options, settings, law=law)
    noise = options.initial_noise
    if options.initial_range and noise > 0.0:
        raise ValueError(f"initial_noise must be 0 where initial_range is given, got {noise}")
    disturbances = Disturbances.named(options.disturbances) or Disturbances()
    _, largest_friction = ends(disturbances.motor_friction)
    randomization = Randomization.named(options.randomization)
    capsule = options.capsule or NOMINAL
    for plant in stiffest_plants(randomization, capsule, largest_friction):
        check_step(plant, plant.M, plant.mu, settings)


@lru_cache(maxsize=16)
def stiffest_plants(
    randomization: Randomization, capsule: Capsule, motor_friction: float
) -> list[Capsule]:
    """The plants among which the stiffest is, with a friction of the motor in N m added.

    They are thousands where all constants are drawn, and the same for many environments.
    """
    plants = []
    # The lightest platform on the roughest floor is the stiffest plant.
    for corner in randomization.corners(capsule):
        plants.append(replace(corner, motor_friction=corner.motor_friction + motor_friction))
    return plants


def check_effects(options: EnvConfig, *, law: bool) -> None:
    """Raises a ValueError for an option that has no effect because of another one.

    A `Randomization` of one's own may draw constants around those of the capsule.

    Args:
        options: options of the environment.
        law: whether a control law runs inside the step.
    """
    limit = options.residual_limit
    same = not law and (limit is None or limit >= options.torque_limit)
    accepted = "False without a controller, where the action is the total torque"
    require(not (options.total_torque and same), "total_torque", accepted, True)
    disturbances = Disturbances.named(options.disturbances) or Disturbances()
    fits = law or disturbances.controls != "law"
    require(fits, "disturbances.controls", "'both' or 'agent' without a controller", "law")
    usual = find_task(options.task).defaults.get("randomization", DEFAULTS.randomization)
    chosen = options.randomization
    if isinstance(chosen, Randomization) and chosen != usual:
        return
    randomization = Randomization.named(chosen)
    capsule = options.capsule or NOMINAL
    for name in ("M", "mu", *randomization.drawn):
        value = getattr(capsule, name)
        fits = getattr(randomization, name) is None or value == getattr(NOMINAL, name)
        accepted = (
            f"left out where the randomization draws it ({randomization}); "
            "randomization='none' keeps the capsule's"
        )
        require(fits, f"capsule.{name}", accepted, value)


def check_periods(options: EnvConfig, settings: Settings, *, law: bool) -> None:
    """Raises a ValueError if the steps of integrator, law and agent do not fit together.

    Each divides the next longer one, at most `_core.MOST_SUBSTEPS` times.
    """
    control_dt = options.control_dt
    physics_dt = settings.physics_dt
    few = control_dt / physics_dt <= _core.MOST_SUBSTEPS
    accepted = f"at most {_core.MOST_SUBSTEPS} times physics_dt={physics_dt!r} s"
    require(few, "control_dt", accepted, control_dt)
    # Without a law, one step of the law is a step of the agent.
    law_name = "the law's step" if law else "control_dt"
    step_name = "the controller's dt" if law else "physics_dt"
    law_dt = settings.law_dt
    _check_division(law_name, law_dt, "physics_dt", physics_dt, settings.physics_steps)
    _check_division("control_dt", control_dt, step_name, law_dt, settings.law_steps)


def _check_division(name: str, whole: float, part_name: str, part: float, count: float) -> None:
    """Raises a ValueError if `part` does not fit `count` times into `whole`, both in seconds."""
    possible = 1 <= count <= _core.MOST_SUBSTEPS
    rounding = 1e-9 * whole
    divides = possible and abs(count * part - whole) <= rounding
    accepted = f"{name}={whole!r} s over a whole number, at most {_core.MOST_SUBSTEPS}"
    require(divides, part_name, accepted, part)


def check_step(capsule: Capsule, M: float, mu: float, settings: Settings) -> None:
    """Raises a ValueError if a plant, with M in kg and mu, is too stiff for the step."""
    h = settings.physics_dt
    rate = capsule.fastest_rate(M, mu)
    if rate * h <= STABLE:
        return
    law_dt = settings.physics_steps * h
    # Steps of the integrator in one of the law; the margin is for rounding.
    enough = law_dt * rate / STABLE * (1.0 + 1e-9)
    advice = "no step would do"
    if enough * settings.law_steps < _core.MOST_SUBSTEPS:
        advice = f"physics_dt={law_dt / math.ceil(enough)!r} would do"
    raise ValueError(
        f"physics_dt must be at most {STABLE / rate:.4g} s for this capsule with M={M:.6g} kg and "
        f"mu={mu:.6g}, whose fastest rate is {rate:.4g} 1/s: beyond {STABLE} / rate the integrator "
        f"is unstable; {advice}, got {h!r} s"
    )


@lru_cache(maxsize=16)
def _plant_draws(randomization: Randomization, capsule: Capsule) -> np.ndarray:
    """The lines of the draw table for M and mu."""
    description = describe(EnvConfig(randomization=randomization, capsule=capsule), None)
    end = description.layout.task_draws
    return np.array(description.draws[end - 2 : end])


def draw_plant(
    randomization: Randomization, capsule: Capsule, rng: np.random.Generator
) -> tuple[float, float]:
    """Draws M in kg and mu as an episode does."""
    *_, low, width, distribution = _plant_draws(randomization, capsule).T
    (drawn,) = evaluate("number_at", rng.random(2), low, width, distribution)
    M, mu = drawn.tolist()
    return M, mu


def entries_of(options: EnvConfig) -> dict[str, tuple[float, float]]:
    """The entries of the observation in order, each with its bounds.

    The names of entries of n steps ago end with n. The controller of the options is not imported.
    """
    controller = None if options.controller is None else NO_CONTROLLER
    return bounds(describe(options, controller))


def bounds(description: Description) -> dict[str, tuple[float, float]]:
    """The bounds of the observation's entries by name, in order."""
    return {name: (low, high) for name, low, high in description.entries}


def as_arrays(description: Description) -> dict[str, Any]:
    """The description as the arrays that the core's `Batch` holds."""
    return {
        "settings": np.array(description.settings, np.float64),
        "layout": np.array(description.layout, np.int64),
        "draw_table": np.array(description.draws, np.float64),
    }
