"""The class `Task`, and the reasons for termination and the metrics that all tasks share.

A task is a module of this folder; its reward, its memory and its observation are in `capsule_gym/core/tasks`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

from capsule_gym.core import _core
from capsule_gym.parameters import Capsule, Randomization

ENV_ID = "CapsuleStickSlip-v0"
EPISODE_STEPS = 1650
CONTROL_DT = 0.02
HORIZON = EPISODE_STEPS * CONTROL_DT
TORQUE_LIMIT = 1.5
# Weight of a joule, and penalty of a failure, in centimetres of progress.
ENERGY_WEIGHT = 0.1
TERMINATION_PENALTY = 10.0
THETA_LIMIT = _core.THETA_LIMIT
START_THETA = -math.pi / 3.0
# Limits of a reset: |theta| below THETA_LIMIT, and up to this |theta_dot| (rad/s), |x| (m) and |x_dot| (m/s).
LARGEST_STATE = (THETA_LIMIT, 1e3, 1e6, 1e3)

# Keys of a change of the plant within an episode.
CHANGE = ("t", "M", "mu")

# Defaults of the tasks that need grip. Their floors range from rubber to plastic; static friction is about a third
# larger than kinetic friction.
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

    none = 0
    pendulum = 1
    contact = 2
    diverged = 3


METRICS = {
    "mean_speed": "displacement over the length of a whole episode, cm/s",
    "cost_of_transport": "energy over weight and distance; infinite without forward progress",
    "peak_torque": "largest |u|, N m",
    "rms_torque": "root mean square of u, N m",
    "backward_ratio": "backward over forward travel; infinite with backward travel only, 0 at rest",
    "stuck_fraction": "share of the time in stick",
    "smallest_normal_ratio": "smallest N / ((M + m) g)",
    "largest_theta": "largest |theta|, rad",
    "largest_theta_dot": "largest |theta_dot|, rad/s",
    "distance": "displacement, m",
    "energy": "integral of |u theta_dot|, J",
    "duration": "length of the episode, s",
    "failed": "1 if the episode terminated, else 0",
}
"""The metrics of an episode, and what they are."""


class Draw(NamedTuple):
    """A number that every episode draws uniformly from [low, high], where `signed` with a random sign."""

    low: float
    high: float
    signed: bool = False


class Option(NamedTuple):
    """Numbers that every episode of a task draws, and that `reset(options={name: value})` sets.

    parse(name, value) returns the numbers for a value of the option; its TypeError or ValueError names the option.
    """

    draws: tuple[Draw, ...]
    parse: Callable[[str, Any], list[float]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A task of the core: its names, draws and metrics; reward, memory and observation are in the core.

    The memory's last fields are the numbers that an episode draws, in the order of `options`.

    Attributes:
        name: value of the environment's argument `task`.
        env_id: id by which Gymnasium knows the environment.
        episode_steps: agent steps until truncation.
        term: name in `info` of the task's reward term, to which the energy and termination terms are added.
        entries: names of the additional entries, which end the observation, and the bounds to which they are clipped.
        shown: fields of the memory that `info` contains; `render` marks the position of a "goal" or a "target" (m).
        options: numbers that an episode draws, by the name of their reset option.
        metrics: metrics(memory, whole) -> metrics by name, in addition to `METRICS`. The fields of `memory`
            are arrays with one entry per episode; `whole` is the length of a whole episode in s.
        defaults: arguments of the environment that differ from those of the speed task.
    """

    name: str
    env_id: str = ENV_ID
    episode_steps: int = EPISODE_STEPS
    term: str
    entries: dict[str, tuple[float, float]] = field(default_factory=dict)
    shown: tuple[str, ...] = ()
    options: dict[str, Option] = field(default_factory=dict)
    metrics: Callable[..., dict[str, Any]] = lambda memory, whole: {}
    defaults: dict[str, Any] = field(default_factory=dict)

    @property
    def number(self) -> int:
        """The number of the task in the core."""
        return list(_core.TASKS).index(self.name)

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the numbers in the memory of one environment."""
        return tuple(_core.TASKS[self.name].split())

    @property
    def rows(self) -> int:
        """Numbers in the memory of one environment."""
        return len(self.fields)

    @cached_property
    def places(self) -> list[tuple[str, int]]:
        """The names in `shown`, and where they are in the memory."""
        return [(name, self.fields.index(name)) for name in self.shown]

    @property
    def draws(self) -> list[Draw]:
        """Everything that an episode draws."""
        return [draw for option in self.options.values() for draw in option.draws]

    @property
    def reward_terms(self) -> tuple[str, str, str]:
        """The names in `info` of the terms whose sum is the reward."""
        return self.term, "reward_energy", "reward_termination"
