"""Options of the environments, `EnvConfig`, with their checks. The docstring of `CapsuleEnv`
describes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

from capsule_gym.checks import (
    check_choice,
    check_count,
    check_flag,
    check_number,
    from_fields,
    nearest,
    require,
    short_repr,
)
from capsule_gym.control.controller import Controller
from capsule_gym.core import _core
from capsule_gym.parameters import Capsule, Disturbances, Randomization
from capsule_gym.parameters.limits import LONGEST_STEP, SHORTEST_STEP
from capsule_gym.tasks import task
from capsule_gym.tasks.registry import find_task
from capsule_gym.tasks.task import Task

# s: the integrator's step without and with a law.
DIRECT_PHYSICS_DT = _core.DIRECT_PHYSICS_DT
LAW_PHYSICS_DT = _core.LAW_PHYSICS_DT
# N m, and cm: within these limits no sum of an episode overflows.
LARGEST_TORQUE, LARGEST_COST = 1e6, 1e12
RENDER_MODES = ("human", "rgb_array")
LARGEST_STACK = 100

Check = Callable[[str, Any], Any]


def _number(low: float, high: float, unit: str, *, open_low: bool = False) -> Check:
    """A check of a number with that unit between two limits."""
    bounds = f"> {low:g} ({unit})" if open_low else f">= {low:g} ({unit})"
    return partial(
        check_number,
        accepted=f"a finite number {bounds}, at most {high:g}",
        low=low,
        high=high,
        open_low=open_low,
    )


def check_object(name: str, value: Any, kind: Any) -> Any:
    """Checks a `Capsule`, a `Randomization` or a `Disturbances`, or makes it of the dict that JSON
    contains instead.
    """
    if isinstance(value, dict):
        return from_fields(kind, name, value)
    if kind is Capsule:
        require(isinstance(value, Capsule), name, "a Capsule or None", value, TypeError)
    else:
        kind.named(value)
    return value


def _check_range(name: str, value: Any) -> tuple[float, float]:
    """Checks half widths of the initial theta and theta_dot; lists are accepted, as policy files
    contain lists only.
    """
    largest, fastest = math.nextafter(task.THETA_LIMIT, 0.0), task.LARGEST_STATE[1]
    accepted = f"None or (theta < pi/2 in rad, theta_dot <= {fastest:g} in rad/s), both >= 0"
    require(isinstance(value, (tuple, list)) and len(value) == 2, name, accepted, value, TypeError)
    theta, theta_dot = value
    return check_number(name, theta, accepted, 0.0, largest), check_number(
        name, theta_dot, accepted, 0.0, fastest
    )


def _option(default: Any, check: Check) -> Any:
    """A field with its check, which returns the value to keep or raises an error that names the
    option.

    An option whose default is None accepts None, too.
    """
    return field(default=default, metadata={"check": check})


def _advice(name: str, known: Iterable[str]) -> str:
    """The end of the message for an unknown option: where a quantity of this name is set, or a
    similar option.
    """
    if name in ("M", "mu"):
        return f"; every reset draws it from randomization=Randomization({name}=(low, high)), or options[{name!r}]"
    for kind in (Capsule, Disturbances):
        if name in (each.name for each in fields(kind)):
            return f"; it is set with {kind.__name__.lower()}={kind.__name__}({name}=..)"
    return nearest(name, known)


@dataclass(frozen=True)
class EnvConfig:
    """The options of an environment; None stands for a value that follows from the other options.

    An omitted option has the default of the task, or else that of the field, which is the speed
    task's.

    Raises:
        TypeError: if an option is unknown or of the wrong type.
        ValueError: if an option is out of range.
    """

    # `find_controller` checks it, and `find_task` the task.
    controller: str | Controller | Callable[[], Controller] | None = None
    residual_limit: float | None = _option(None, _number(0.0, LARGEST_TORQUE, "N m"))
    total_torque: bool = _option(False, check_flag)
    torque_limit: float = _option(
        task.TORQUE_LIMIT, _number(0.0, LARGEST_TORQUE, "N m", open_low=True)
    )
    randomization: str | Randomization = _option("paper", partial(check_object, kind=Randomization))
    disturbances: str | Disturbances = _option("none", partial(check_object, kind=Disturbances))
    capsule: Capsule | None = _option(None, partial(check_object, kind=Capsule))
    observe_parameters: bool = _option(False, check_flag)
    observe_estimates: bool = _option(False, check_flag)
    stack_size: int = _option(1, partial(check_count, most=LARGEST_STACK))
    energy_weight: float = _option(task.ENERGY_WEIGHT, _number(0.0, LARGEST_COST, "cm/J"))
    termination_penalty: float = _option(task.TERMINATION_PENALTY, _number(0.0, LARGEST_COST, "cm"))
    initial_noise: float = _option(0.0, _number(0.0, 0.5, "rad"))
    initial_range: tuple[float, float] | None = _option(None, _check_range)
    control_dt: float = _option(task.CONTROL_DT, _number(SHORTEST_STEP, LONGEST_STEP, "s"))
    physics_dt: float | None = _option(None, _number(SHORTEST_STEP, LONGEST_STEP, "s"))
    threads: int = _option(1, check_count)
    render_mode: str | None = _option(
        None, partial(check_choice, choices=RENDER_MODES, accepted=f"None or one of {RENDER_MODES}")
    )
    task: str | Task = "speed"
    goal_env: bool = _option(False, check_flag)

    def __init__(self, **options: Any) -> None:
        defaults = {each.name: each.default for each in fields(self)}
        checks = {each.name: each.metadata.get("check") for each in fields(self)}
        if unknown := sorted(set(options) - set(defaults)):
            advice = _advice(unknown[0], defaults)
            raise TypeError(f"got an unexpected keyword argument {short_repr(unknown[0])}{advice}")
        given = {**defaults, **find_task(options.get("task", "speed")).defaults, **options}
        for name, value in given.items():
            if (check := checks[name]) and not (value is None and defaults[name] is None):
                value = check(name, value)
            object.__setattr__(self, name, value)
        name = find_task(self.task).name
        require(
            name == "goal" or not self.goal_env,
            "goal_env",
            f"False for the task {name!r}",
            self.goal_env,
        )
