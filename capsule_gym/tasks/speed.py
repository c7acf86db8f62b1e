"""The speed task, `CapsuleStickSlip-v0`: forwards as fast as possible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsule_gym.compilation import inlined
from capsule_gym.task import Task


class Memory(NamedTuple):
    """The task has no memory."""


@inlined
def reward(x: float, x_dot: float, moved: float, dt: float, memory: Memory) -> tuple[float, Memory]:
    """Centimetres of forward progress."""
    return 100.0 * moved, memory


@inlined
def begin(x: float, memory: Memory) -> Memory:
    """Returns the empty memory."""
    return memory


@inlined
def observe(out: np.ndarray, x: float, memory: Memory) -> None:
    """Writes nothing, since the task does not depend on the position."""


TASK = Task(
    name="speed",
    term="reward_progress",
    reward=reward,
    memory=Memory,
    begin=begin,
    observe=observe,
)
