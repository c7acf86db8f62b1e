"""What an environment can be told: each option's name, type, default, range and line of documentation, once.

`CapsuleEnv` and `CapsuleVectorEnv` write them out in their signatures and docstrings, where editors and pages look for
them; `tests/capsule_gym/test_options.py` holds those to what stands here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np

from capsule_gym import task
from capsule_gym.controller import LAW_DT, Controller
from capsule_gym.parameters import RANDOMIZATIONS, SMALLEST, Capsule, Randomization, check_count, check_number, written

DIRECT_PHYSICS_DT = 2e-3
LAW_PHYSICS_DT = LAW_DT
# Steps of the integrator in a step of the agent: what takes a tenth of a second.
MOST_SUBSTEPS = 1_000_000
# N m, and cm: with these no sum of an episode leaves the floating-point numbers.
LARGEST_TORQUE, LARGEST_COST = 1e6, 1e12
# Energy weights that a policy can be told, cm/J: their logarithms are numbers.
TOLD_ENERGY_WEIGHTS = SMALLEST, LARGEST_COST
TOLD = f"a number of cm/J from {SMALLEST:g} to {LARGEST_COST:g}"
# s. Steps of more digits than these would not divide each other, whatever they are.
SHORTEST_STEP, LONGEST_STEP = 1e-9, 1e6
RENDER_MODES = ("human", "rgb_array")

Check = Callable[[str, Any], Any]


def _anything(name: str, value: Any) -> Any:
    """For what is checked where it is resolved."""
    return value


def _positive(unit: str, most: float) -> Check:
    accepted = f"a finite number > 0 ({unit}), at most {most:g}"
    return partial(check_number, accepted=accepted, low=0.0, high=most, open_low=True)


def _is_step(name: str, value: Any) -> float:
    accepted = f"a finite number of s in [{SHORTEST_STEP:g}, {LONGEST_STEP:g}]"
    return check_number(name, value, accepted, SHORTEST_STEP, LONGEST_STEP)


def _at_least_zero(unit: str, most: float) -> Check:
    return partial(check_number, accepted=f"a finite number >= 0 ({unit}), at most {most:g}", low=0.0, high=most)


def _or_none(check: Check) -> Check:
    """A check that lets None through."""
    return lambda name, value: None if value is None else check(name, value)


def _is_capsule(name: str, value: Any) -> Capsule:
    if not isinstance(value, Capsule):
        raise TypeError(f"{name} must be a Capsule or None, got {written(value)}")
    return value


def _is_noise(name: str, value: Any) -> float:
    return check_number(name, value, "a number of rad in [0, 0.5]", 0.0, 0.5)


def _is_randomization(name: str, value: Any) -> str | Randomization:
    Randomization.named(value)
    return value


def _is_bool(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {written(value)}")
    return bool(value)


def _is_render_mode(name: str, value: Any) -> str:
    # Of an array, `in` has no answer.
    if not isinstance(value, str) or value not in RENDER_MODES:
        raise ValueError(f"{name} must be None or one of {RENDER_MODES}, got {written(value)}")
    return value


def _about(doc: str, check: Check, shown: str | None = None) -> dict[str, Any]:
    """What a field of `Options` says of itself.

    Args:
        doc: one line on what it is, with its unit.
        check: returns a value as it is kept, or raises a TypeError or ValueError that names the option.
        shown: the default in words; None where its value says it.
    """
    return {"doc": doc, "check": check, "shown": shown}


_RANGES = "; ".join(f'"{name}": {ranges}' for name, ranges in RANDOMIZATIONS.items())


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of an environment; each field says below what it is, and what is None where it follows from others.

    Raises:
        TypeError: if an option is of the wrong type.
        ValueError: if an option is out of range.
    """

    controller: str | Controller | Callable[[], Controller] | None = field(
        default=None,
        metadata=_about(
            'control law inside the step: an import string "module:attribute", a `Controller`, or a function that '
            "returns one",
            _anything,
        ),
    )
    residual_limit: float | None = field(
        default=None,
        metadata=_about(
            "torque of the action 1, N m", _or_none(_at_least_zero("N m", LARGEST_TORQUE)), "`torque_limit`"
        ),
    )
    torque_limit: float = field(
        default=task.TORQUE_LIMIT, metadata=_about("largest motor torque, N m", _positive("N m", LARGEST_TORQUE))
    )
    randomization: str | Randomization = field(
        default="paper",
        metadata=_about(
            f"where M and mu of an episode come from: {_RANGES}; or a `Randomization`",
            _is_randomization,
        ),
    )
    capsule: Capsule | None = field(
        default=None, metadata=_about("the plant's constants", _or_none(_is_capsule), "`Capsule()`")
    )
    observe_parameters: bool = field(
        default=False, metadata=_about("whether the observation ends with M and mu", _is_bool)
    )
    energy_weight: float = field(
        default=task.ENERGY_WEIGHT,
        metadata=_about("centimetres that a joule costs", _at_least_zero("cm/J", LARGEST_COST)),
    )
    termination_penalty: float = field(
        default=task.TERMINATION_PENALTY,
        metadata=_about("centimetres that a failure costs", _at_least_zero("cm", LARGEST_COST)),
    )
    initial_noise: float = field(
        default=0.0, metadata=_about("half width of the uniform noise on the initial angle, rad", _is_noise)
    )
    control_dt: float = field(default=task.CONTROL_DT, metadata=_about("agent step, s", _is_step))
    physics_dt: float | None = field(
        default=None,
        metadata=_about(
            "step of the fourth-order integrator, s; at most a million in an agent step",
            _or_none(_is_step),
            f"{1e3 * DIRECT_PHYSICS_DT:g} ms, with a controller {1e3 * LAW_PHYSICS_DT:g} ms",
        ),
    )
    threads: int = field(
        default=1,
        metadata=_about(
            "threads that share a batch, from 64 environments each; the results do not depend on it", check_count
        ),
    )
    render_mode: str | None = field(
        default=None, metadata=_about('"human" or, also of a batch, "rgb_array"', _or_none(_is_render_mode))
    )

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, each.metadata["check"](each.name, getattr(self, each.name)))

    @classmethod
    def among(cls, arguments: Mapping[str, Any]) -> Options:
        """The options among a function's arguments, as `locals()` gives them; the others keep their defaults."""
        names = {each.name for each in fields(cls)}
        return cls(**{name: value for name, value in arguments.items() if name in names})


DEFAULTS = Options()
DOCS: dict[str, str] = {each.name: each.metadata["doc"] for each in fields(Options)}
"""The line of documentation of each option."""
