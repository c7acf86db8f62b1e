"""What every task shares: what a `Task` is, clips, termination and the metrics of an episode.

The tasks themselves are in `capsule_gym.tasks`. The functions of a single time step are plain scalar functions;
`capsule_gym.kernels` compiles them into the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

ENV_ID = "CapsuleStickSlip-v0"
EPISODE_STEPS = 1650
CONTROL_DT = 0.02
HORIZON = EPISODE_STEPS * CONTROL_DT
TORQUE_LIMIT = 1.5
# In centimetres of progress: a joule, and a failure.
ENERGY_WEIGHT = 0.1
TERMINATION_PENALTY = 10.0
THETA_LIMIT = math.pi / 2.0
START_THETA = -math.pi / 3.0
# What a reset may set: |theta| below THETA_LIMIT, and up to this |theta_dot| (rad/s), |x| (m) and |x_dot| (m/s).
LARGEST_STATE = (THETA_LIMIT, 1e3, 1e6, 1e3)
# |theta_dot| + |x_dot| (rad/s, m/s) at an event, such as the end of an episode, beyond which the motion counts as lost.
RATE_LIMIT = 1e4


# The tasks by the value of the environment's argument `task`, which is also the name of its module in
# `capsule_gym.tasks`: the id that Gymnasium knows the environment by, and agent steps until truncation.
TASKS = {
    "speed": (ENV_ID, EPISODE_STEPS),
    "goal": ("CapsuleGoal-v0", 750),
    "velocity": ("CapsuleVelocity-v0", 1000),
}


class Termination(IntEnum):
    """Why an episode ended before its time."""

    none = 0
    pendulum = 1
    contact = 2
    diverged = 3


class Metrics(NamedTuple):
    """The metrics of an episode, each of shape (environments,), float64."""

    mean_speed: np.ndarray  # cm/s
    cost_of_transport: np.ndarray  # energy over weight and distance; infinite without forward progress
    peak_torque: np.ndarray  # N m
    rms_torque: np.ndarray  # N m
    backward_ratio: np.ndarray  # travel backwards over travel forwards; infinite with the former alone, 0 at rest
    stuck_fraction: np.ndarray  # share of the time in stick
    smallest_normal_ratio: np.ndarray  # smallest N / ((M + m) g)
    largest_theta: np.ndarray  # largest |theta|, rad
    largest_theta_dot: np.ndarray  # largest |theta_dot|, rad/s
    distance: np.ndarray  # m
    energy: np.ndarray  # integral of |u theta_dot|, J
    duration: np.ndarray  # s
    failed: np.ndarray  # 1 where the episode terminated, else 0


METRICS = Metrics._fields


class Draw(NamedTuple):
    """How a number of an episode is drawn: uniformly."""

    low: float
    high: float
    # Whether low and high are those of its size, and either sign is equally likely.
    signed: bool = False


class Option(NamedTuple):
    """What an episode of a task draws, and `reset(options={name: value})` sets."""

    draws: tuple[Draw, ...]
    # Takes the name of the argument and a value, and returns as many numbers as there are draws; raises a TypeError or
    # ValueError that names the argument.
    parse: Callable[[str, Any], list[float]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What the agent is to do: reward, further observations, memory, and metrics. The plant and failures are shared.

    Functions of a time step are scalar functions that numba compiles, marked `capsule_gym.compilation.inlined`. The
    task's memory is a named tuple of floats, which they take and return; the numbers that an episode draws are its last
    fields, in the order of `options`. A law made for the task (`Controller.task`) gets it behind its reference.

    Attributes:
        name: value of the environment's argument `task`.
        episode_steps: agent steps until truncation.
        term: name of the task's reward in `info`; the costs of energy and failure are added to it.
        reward: reward(x, x_dot, moved, dt, memory) -> (reward, memory) at the end of an agent step of dt seconds, in
            which the platform has moved by so many metres.
        memory: class of the memory.
        begin: begin(x, memory) -> memory at the start of an episode; before, what is not drawn is 0.
        entries: names of the entries that end the observation, with the bounds that they are clipped to.
        observe: observe(out, x, memory) writes those entries into an array.
        shown: fields of the memory that `info` shows under their names; `render` marks the place of a "goal" or a
            "target" (m).
        options: by name, what an episode draws.
        metrics: metrics(memory, whole) -> its metrics by name, beside those of `Metrics`: of a memory of arrays, one
            entry per episode, and the length in s that a failed episode should have had.
        defaults: arguments of its environment that differ from those of the speed task.
    """

    name: str
    episode_steps: int = EPISODE_STEPS
    term: str
    reward: Callable[..., Any]
    memory: Any
    begin: Callable[..., Any]
    entries: dict[str, tuple[float, float]] = field(default_factory=dict)
    observe: Callable[..., Any]
    shown: tuple[str, ...] = ()
    options: dict[str, Option] = field(default_factory=dict)
    metrics: Callable[..., dict[str, Any]] = lambda memory, whole: {}
    defaults: dict[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Numbers in the memory of one environment."""
        return len(self.memory._fields)

    @cached_property
    def places(self) -> list[tuple[str, int]]:
        """The names in `shown`, and where they are in the memory."""
        return [(name, self.memory._fields.index(name)) for name in self.shown]

    @property
    def draws(self) -> list[Draw]:
        """Everything that an episode draws."""
        return [draw for option in self.options.values() for draw in option.draws]

    @property
    def reward_terms(self) -> tuple[str, str, str]:
        """The names in `info` of the terms whose sum is the reward."""
        return self.term, "reward_energy", "reward_termination"


def termination(theta: float, normal_force: float) -> int:
    """`Termination` as an integer: the ball meets the platform, or the platform leaves the floor."""
    if abs(theta) >= THETA_LIMIT:
        return 1
    if normal_force <= 0.0:
        return 2
    return 0


def continues(theta: float, normal_force: float) -> bool:
    """Whether `termination` is 0 and both are numbers.

    That finds every step that has left the numbers: with the sizes that a plant and a torque may have, accelerations
    that overflow grow so fast from stage to stage that none cancels another in theta. A comparison more would be a
    tenth of the kernel's time.
    """
    return abs(theta) < THETA_LIMIT and normal_force > 0.0


def bounded(theta_dot: float, x_dot: float) -> bool:
    """Whether the rates are those of a motion that the integrator resolves; NaN is not."""
    return abs(theta_dot) + abs(x_dot) <= RATE_LIMIT
