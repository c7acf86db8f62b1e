"""Options of the environments, `EnvConfig`, with their checks.

The table of arguments in the docstring of `CapsuleEnv` lists them.
"""

# ruff: noqa: RUF009 (`_option` returns a field of the dataclass)
from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym import _core, task
from capsule_gym.checks import check_count, check_name, check_number, nearest, written
from capsule_gym.parameters import (
    LONGEST_STEP,
    RANDOMIZATIONS,
    SHORTEST_STEP,
    SMALLEST,
    Capsule,
    Disturbances,
    Randomization,
)
from capsule_gym.task import Task

if TYPE_CHECKING:
    from capsule_gym.controller import Controller

DIRECT_PHYSICS_DT = 2e-3
# Period of a control law inside the step, s, unless its `Controller` sets another one.
LAW_DT = LAW_PHYSICS_DT = 1e-3
# Largest number of integrator steps per agent step, which take a tenth of a second.
MOST_SUBSTEPS = 1_000_000
# N m, and cm: within these limits no sum of an episode overflows.
LARGEST_TORQUE, LARGEST_COST = 1e6, 1e12
# Energy weights that a policy can observe, cm/J: their logarithms are finite.
ENERGY_WEIGHTS = SMALLEST, LARGEST_COST
ENERGY_WEIGHT_TEXT = f"a number of cm/J from {SMALLEST:g} to {LARGEST_COST:g}"
RENDER_MODES = ("human", "rgb_array")
LARGEST_STACK = 100

Check = Callable[[str, Any], Any]


def _number(low: float, high: float, unit: str, *, open_low: bool = False) -> Check:
    """A check of a number with that unit between two limits."""
    bounds = f"> {low:g} ({unit})" if open_low else f">= {low:g} ({unit})"
    return partial(
        check_number, accepted=f"a finite number {bounds}, at most {high:g}", low=low, high=high, open_low=open_low
    )


def _or_none(check: Check) -> Check:
    """A check that accepts None, too."""
    return lambda name, value: None if value is None else check(name, value)


def find_task(value: Any) -> Task:
    """The task that the environment's argument `task` names; a `Task` is returned unchanged.

    Raises:
        TypeError: if it is neither a string nor a `Task`.
        ValueError: if the core has no task of that name.
    """
    if isinstance(value, Task):
        if value.name not in _core.TASKS:
            accepted = f"one of {sorted(_core.TASKS)}; a wrapper of the environment makes other tasks"
            raise ValueError(f"task.name must be {accepted}, got {written(value.name)}")
        return value
    # Only the module of this task is imported.
    found: Task = importlib.import_module(f"capsule_gym.tasks.{check_name('task', value, Task, task.TASKS)}").TASK
    return found


def _found_by(find: Callable[[Any], Any]) -> Check:
    """A check of a value that `find` resolves; the value itself is kept unchanged."""

    def check(name: str, value: Any) -> Any:
        find(value)
        return value

    return check


def _instance(accepted: str, *kinds: type) -> Check:
    """A check of a value's type."""

    def check(name: str, value: Any) -> Any:
        if not isinstance(value, kinds):
            raise TypeError(f"{name} must be {accepted}, got {written(value)}")
        return bool(value) if bool in kinds else value

    return check


def _is_range(name: str, value: Any) -> tuple[float, float]:
    """Checks half widths of the initial theta and theta_dot; lists are accepted, as policy files contain lists only."""
    largest, fastest = math.nextafter(task.THETA_LIMIT, 0.0), task.LARGEST_STATE[1]
    accepted = f"None or (theta < pi/2 in rad, theta_dot <= {fastest:g} in rad/s), both >= 0"
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{name} must be {accepted}, got {written(value)}")
    theta, theta_dot = value
    return check_number(name, theta, accepted, 0.0, largest), check_number(name, theta_dot, accepted, 0.0, fastest)


def _is_render_mode(name: str, value: Any) -> str:
    # `in` raises an error for an array.
    if not isinstance(value, str) or value not in RENDER_MODES:
        raise ValueError(f"{name} must be None or one of {RENDER_MODES}, got {written(value)}")
    return value


def _option(default: Any, doc: str, check: Check = lambda name, value: value) -> Any:
    """A field of `EnvConfig`, with a line of documentation that names its unit.

    `check` returns the value to keep, or raises a TypeError or ValueError that names the option. Without a check the
    value is checked where it is resolved.
    """
    return field(default=default, metadata={"doc": doc, "check": check})


_IS_STEP = _number(SHORTEST_STEP, LONGEST_STEP, "s")
_RANGES = "; ".join(f'"{name}": {ranges}' for name, ranges in RANDOMIZATIONS.items())


@dataclass(frozen=True, kw_only=True, init=False)
class EnvConfig:
    """The options of an environment; None stands for a value that follows from the other options.

    An omitted option has the default of the task, or else that of the field, which is the speed task's.

    Raises:
        TypeError: if an option is unknown or of the wrong type.
        ValueError: if an option is out of range.
    """

    controller: str | Controller | Callable[[], Controller] | None = _option(
        None,
        'control law inside the step: an import string "module:attribute", a `Controller`, or a function that '
        "returns one",
    )
    residual_limit: float | None = _option(
        None, "torque of an action of 1, N m", _or_none(_number(0.0, LARGEST_TORQUE, "N m"))
    )
    total_torque: bool = _option(
        False,
        "whether the action is the total torque, in units of torque_limit, kept within residual_limit of the law's "
        "torque",
        _instance("True or False", bool, np.bool_),
    )
    torque_limit: float = _option(
        task.TORQUE_LIMIT, "largest motor torque, N m", _number(0.0, LARGEST_TORQUE, "N m", open_low=True)
    )
    randomization: str | Randomization = _option(
        "paper",
        f"distribution of the plant, drawn at every reset: {_RANGES}; or a `Randomization`",
        _found_by(Randomization.named),
    )
    disturbances: str | Disturbances = _option(
        "none",
        'imperfect sensors and motor: "none"; "real": noise, bias and drift of the sensors, 5 to 15 ms of latency, lag '
        "and friction of the motor; or a `Disturbances`",
        _found_by(Disturbances.named),
    )
    capsule: Capsule | None = _option(None, "the plant's constants", _or_none(_instance("a Capsule or None", Capsule)))
    observe_parameters: bool = _option(
        False, "whether the observation ends with M and mu", _instance("True or False", bool, np.bool_)
    )
    stack_size: int = _option(
        1,
        "number of observations, the newest first, that one observation stacks",
        partial(check_count, most=LARGEST_STACK),
    )
    energy_weight: float = _option(
        task.ENERGY_WEIGHT, "weight of the energy in the reward, cm/J", _number(0.0, LARGEST_COST, "cm/J")
    )
    termination_penalty: float = _option(
        task.TERMINATION_PENALTY, "penalty of a termination in the reward, cm", _number(0.0, LARGEST_COST, "cm")
    )
    initial_noise: float = _option(
        0.0, "half width of the uniform noise on the initial angle, rad", _number(0.0, 0.5, "rad")
    )
    initial_range: tuple[float, float] | None = _option(
        None,
        "half widths (rad, rad/s) of uniform distributions around 0 of the initial theta and theta_dot; None starts at "
        "rest at -pi/3",
        _or_none(_is_range),
    )
    control_dt: float = _option(task.CONTROL_DT, "agent step, s", _IS_STEP)
    physics_dt: float | None = _option(
        None, "step of the fourth-order integrator, s; at most a million steps per agent step", _or_none(_IS_STEP)
    )
    threads: int = _option(
        1,
        "number of threads that step a batch, each at least 64 environments; results do not depend on it",
        check_count,
    )
    render_mode: str | None = _option(None, '"human" or, also of a batch, "rgb_array"', _or_none(_is_render_mode))
    task: str | Task = _option(
        "speed", f"the task: {', '.join(task.TASKS)}, or what `velocity.with_commands` returns", _found_by(find_task)
    )

    def __init__(self, **options: Any) -> None:
        known = {each.name: each for each in fields(self)}
        if unknown := sorted(set(options) - set(known)):
            raise TypeError(f"EnvConfig got an unexpected keyword argument {unknown[0]!r}{nearest(unknown[0], known)}")
        given = {**find_task(options.get("task", known["task"].default)).defaults, **options}
        for name, each in known.items():
            object.__setattr__(self, name, each.metadata["check"](name, given.get(name, each.default)))


DOCS: dict[str, str] = {each.name: each.metadata["doc"] for each in fields(EnvConfig)}
"""The line of documentation of each option."""
