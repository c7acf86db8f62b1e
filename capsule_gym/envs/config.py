"""The options of the environments, their descriptions and their checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, TypedDict

from typing_extensions import Unpack

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
LARGEST_TORQUE = 1e6
LARGEST_COST = 1e12
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
    """Checks an object of that kind, or makes it of the dict that JSON contains instead.

    The kind is `Capsule`, `Randomization` or `Disturbances`.
    """
    if isinstance(value, dict):
        return from_fields(kind, name, value)
    if kind is Capsule:
        require(isinstance(value, Capsule), name, "a Capsule or None", value, TypeError)
    else:
        kind.named(value)
    return value


def _check_range(name: str, value: Any) -> tuple[float, float]:
    """Checks the half widths of the initial theta and theta_dot.

    Lists are accepted, as policy files contain lists only.
    """
    largest_angle = math.nextafter(task.THETA_LIMIT, 0.0)
    largest_rate = task.LARGEST_STATE[1]
    accepted = f"None or (theta < pi/2 in rad, theta_dot <= {largest_rate:g} in rad/s), both >= 0"
    pair = isinstance(value, (tuple, list)) and len(value) == 2
    require(pair, name, accepted, value, TypeError)
    angle, rate = value
    theta = check_number(name, angle, accepted, 0.0, largest_angle)
    theta_dot = check_number(name, rate, accepted, 0.0, largest_rate)
    return theta, theta_dot


def _option(default: Any, description: str, check: Check | None = None) -> Any:
    """A field whose check returns the value to keep, or raises an error that names the option.

    An option whose default is None accepts None, too.
    """
    return field(default=default, metadata={"description": description, "check": check})


def _advice(name: str, known: Iterable[str]) -> str:
    """The end of the message for an unknown option: where it is set, or a similar option."""
    if name in ("M", "mu"):
        drawn = f"randomization=Randomization({name}=(low, high))"
        return f"; every reset draws it from {drawn}, or options[{name!r}]"
    for kind in (Capsule, Disturbances):
        if name in (each.name for each in fields(kind)):
            return f"; it is set with {kind.__name__.lower()}={kind.__name__}({name}=..)"
    return nearest(name, known)


class EnvOptions(TypedDict, total=False):
    """The options of an environment except `render_mode`, for editors and type checkers."""

    controller: str | Controller | Callable[[], Controller] | None
    residual_limit: float | None
    total_torque: bool
    torque_limit: float
    randomization: str | Randomization
    disturbances: str | Disturbances
    capsule: Capsule | None
    observe_parameters: bool
    observe_estimates: bool
    stack_size: int
    energy_weight: float
    termination_penalty: float
    initial_noise: float
    initial_range: tuple[float, float] | None
    control_dt: float
    physics_dt: float | None
    threads: int
    task: str | Task
    goal_env: bool


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
    controller: str | Controller | Callable[[], Controller] | None = _option(
        None,
        'control law inside the step: an import string "module:attribute", a `Controller`, or a '
        "function that returns one",
    )
    residual_limit: float | None = _option(
        None, "torque of an action of 1, N m", _number(0.0, LARGEST_TORQUE, "N m")
    )
    total_torque: bool = _option(
        False,
        "whether the action is the total torque, in units of torque_limit, kept within "
        "residual_limit of the law's torque",
        check_flag,
    )
    torque_limit: float = _option(
        task.TORQUE_LIMIT,
        "largest motor torque, N m",
        _number(0.0, LARGEST_TORQUE, "N m", open_low=True),
    )
    randomization: str | Randomization = _option(
        "paper",
        "distribution of the plant, drawn at every reset: "
        '"none": the capsule\'s own M and mu; '
        '"paper": M in [0.45, 0.55] kg, mu in [0.009, 0.011]; '
        '"wide": M in [0.35, 0.75] kg, mu log-uniform in [0.005, 0.3]; '
        '"broad": M in [0.25, 1.2] kg, mu log-uniform in [0.002, 0.6]; '
        '"sticky": M in [0.35, 0.75] kg, mu in [0.2, 0.6]; '
        '"real": M in [0.45, 0.55] kg, mu in [0.009, 0.011], '
        "m in [0.1242, 0.1518], l in [0.27, 0.33], k in [0.324, 0.396], c in [0.08307, 0.10153]; "
        '"real-wide": M in [0.35, 0.75] kg, mu log-uniform in [0.005, 0.3], '
        "m in [0.1242, 0.1518], l in [0.27, 0.33], k in [0.324, 0.396], c in [0.08307, 0.10153]; "
        "or a `Randomization`",
        partial(check_object, kind=Randomization),
    )
    disturbances: str | Disturbances = _option(
        "none",
        'imperfect sensors and motor: "none"; "real": noise, bias and drift of the sensors, 5 to '
        "15 ms of latency, lag and friction of the motor; or a `Disturbances`",
        partial(check_object, kind=Disturbances),
    )
    capsule: Capsule | None = _option(
        None, "the plant's constants", partial(check_object, kind=Capsule)
    )
    observe_parameters: bool = _option(
        False, "whether the observation contains M and mu", check_flag
    )
    observe_estimates: bool = _option(
        False,
        "whether the observation contains online estimates of M and log(mu), and their standard "
        "deviations",
        check_flag,
    )
    stack_size: int = _option(
        1,
        "number of observations, the newest first, that one observation stacks",
        partial(check_count, most=LARGEST_STACK),
    )
    energy_weight: float = _option(
        task.ENERGY_WEIGHT,
        "weight of the energy in the reward, cm/J",
        _number(0.0, LARGEST_COST, "cm/J"),
    )
    termination_penalty: float = _option(
        task.TERMINATION_PENALTY,
        "penalty of a termination in the reward, cm",
        _number(0.0, LARGEST_COST, "cm"),
    )
    initial_noise: float = _option(
        0.0,
        "half width of the uniform noise on the initial angle, rad",
        _number(0.0, 0.5, "rad"),
    )
    initial_range: tuple[float, float] | None = _option(
        None,
        "half widths (rad, rad/s) of uniform distributions around 0 of the initial theta and "
        "theta_dot; None starts at rest at -pi/3",
        _check_range,
    )
    control_dt: float = _option(
        task.CONTROL_DT, "agent step, s", _number(SHORTEST_STEP, LONGEST_STEP, "s")
    )
    physics_dt: float | None = _option(
        None,
        "step of the fourth-order integrator, s; at most a million steps per agent step",
        _number(SHORTEST_STEP, LONGEST_STEP, "s"),
    )
    threads: int = _option(
        1,
        "number of threads that step a batch, each at least 128 environments; results do not "
        "depend on it",
        check_count,
    )
    render_mode: str | None = _option(
        None,
        '"human" or, also of a batch, "rgb_array"',
        partial(check_choice, choices=RENDER_MODES, accepted=f"None or one of {RENDER_MODES}"),
    )
    task: str | Task = _option(
        "speed", "the task: speed, goal, velocity, or what `velocity.with_commands` returns"
    )
    goal_env: bool = _option(
        False,
        'only with the task "goal": observations with achieved and desired goals, for hindsight '
        "experience replay",
        check_flag,
    )

    def __init__(self, *, render_mode: str | None = None, **options: Unpack[EnvOptions]) -> None:
        known = {each.name: each for each in fields(self)}
        if unknown := sorted(options.keys() - known):
            advice = _advice(unknown[0], known)
            raise TypeError(f"got an unexpected keyword argument {short_repr(unknown[0])}{advice}")
        task_defaults = find_task(options.get("task", "speed")).defaults
        given = {**task_defaults, **options, "render_mode": render_mode}
        for name, option in known.items():
            value = given.get(name, option.default)
            check = option.metadata["check"]
            unset = value is None and option.default is None
            if check and not unset:
                value = check(name, value)
            object.__setattr__(self, name, value)
        task_name = find_task(self.task).name
        fits = task_name == "goal" or not self.goal_env
        require(fits, "goal_env", f"False for the task {task_name!r}", self.goal_env)


DOCS: dict[str, str] = {each.name: each.metadata["description"] for each in fields(EnvConfig)}
"""The descriptions of the options, which are the help texts of command lines, too."""
