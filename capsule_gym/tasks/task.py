"""The class `Task`, and the reasons for termination and the metrics that all tasks share.

A task is a module of this folder, and a header in `capsule_gym/core/tasks`.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from capsule_gym.checks import check_number
from capsule_gym.core import _core
from capsule_gym.parameters import Capsule, Randomization

ENV_ID = "CapsuleStickSlip-v0"
EPISODE_STEPS = _core.TASKS["speed"].steps
CONTROL_DT = _core.CONTROL_DT
HORIZON = EPISODE_STEPS * CONTROL_DT
TORQUE_LIMIT = 1.5
# Weight of a joule, and penalty of a failure, in centimetres of progress.
ENERGY_WEIGHT = 0.1
TERMINATION_PENALTY = 10.0
THETA_LIMIT = _core.THETA_LIMIT
START_THETA = _core.START_THETA
# Limits of a reset: |theta| below the first (rad), |theta_dot| (rad/s), |x| (m), |x_dot| (m/s).
LARGEST_STATE = (THETA_LIMIT, 1e3, 1e6, 1e3)

# Keys of a change of the plant within an episode.
CHANGE = ("t", "M", "mu")

# Defaults of the tasks that need grip. Their floors range from rubber to plastic; static friction
# is about a third larger than kinetic friction.
GRIP_DEFAULTS: dict[str, Any] = {
    "capsule": Capsule(static_ratio=1.3),
    "randomization": Randomization(M=(0.45, 0.55), mu=(0.05, 0.5), log_mu=True),
    "energy_weight": 0.0,
    "termination_penalty": 3.0,
}


class Termination(IntEnum):
    """Reason for the termination of an episode: 0 none, 1 pendulum, 2 contact, 3 diverged.

    Their limits are in `core/step/step.hpp`.
    """

    none = _core.TERMINATIONS.index("none")
    pendulum = _core.TERMINATIONS.index("pendulum")
    contact = _core.TERMINATIONS.index("contact")
    diverged = _core.TERMINATIONS.index("diverged")


METRICS = _core.METRICS
"""The metrics of an episode, and what they are."""


def parse_numbers(name: str, value: Any) -> list[float]:
    """The numbers of a reset option that is a number or a sequence of numbers."""
    values = [value] if np.ndim(value) == 0 else list(value)
    return [check_number(name, each, "a finite number, or a sequence of them") for each in values]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A task of the core: its memory, reward, part of the observation, draws and metrics.

    Attributes:
        name: value of the environment's argument `task`.
        env_id: id by which Gymnasium knows the environment.
        parsers: by the name of a reset option, parser(name, value) -> the numbers for a value of
            the option; its TypeError or ValueError names the option.
        draw_range: range from which the commands of an episode are drawn; None for that of the
            core.
        defaults: arguments of the environment that differ from those of the speed task.
    """

    name: str
    env_id: str = ENV_ID
    parsers: dict[str, Callable[[str, Any], list[float]]] = field(default_factory=dict)
    draw_range: tuple[float, float] | None = None
    defaults: dict[str, Any] = field(default_factory=dict)

    @property
    def _description(self) -> _core.TaskDescription:
        return _core.TASKS[self.name]

    @cached_property
    def number(self) -> int:
        """The number of the task in the core."""
        return list(_core.TASKS).index(self.name)

    @cached_property
    def episode_steps(self) -> int:
        """Agent steps until truncation."""
        return self._description.steps

    @property
    def horizon(self) -> float:
        """Length of an episode, s."""
        return self.episode_steps * CONTROL_DT

    @cached_property
    def term(self) -> str:
        """The name in `info` of the task's own reward term."""
        return self._description.term

    @cached_property
    def fields(self) -> list[str]:
        """The names of the numbers in the memory of one environment, last those it draws."""
        return self._description.fields

    @cached_property
    def rows(self) -> int:
        """Numbers in the memory of one environment."""
        return len(self.fields)

    @cached_property
    def places(self) -> list[tuple[str, int]]:
        """The fields that `info` contains, and where they are in the memory.

        `render` marks the position of a "goal" or a "target" (m).
        """
        return [(name, self.fields.index(name)) for name in self._description.shown]

    @cached_property
    def option_sizes(self) -> dict[str, int]:
        """How many drawn numbers each reset option sets, in the order of the memory."""
        return dict(Counter(option for option, *_ in self._description.draws))

    @property
    def metrics(self) -> dict[str, str]:
        """The metrics of an episode in addition to `METRICS`, and what they are."""
        return self._description.metrics

    @cached_property
    def reward_terms(self) -> tuple[str, str, str]:
        """The names in `info` of the terms whose sum is the reward."""
        return self.term, "reward_energy", "reward_termination"

    def parse(self, option: str, value: Any) -> list[float]:
        """The numbers for a value of a reset option.

        Raises:
            TypeError: if the value is of the wrong type.
            ValueError: if it is out of range.
        """
        parser = self.parsers.get(option, parse_numbers)
        return parser(f"options[{option!r}]", value)
