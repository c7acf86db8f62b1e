"""Who is taught: students, what they meet and see, and how much their runs take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from baselines.dynamic_programming import MIN_NORMAL_FORCE


@dataclass(frozen=True)
class Budget:
    """How much a run takes.

    Attributes:
        num_envs: episodes of a lesson.
        steps: of each.
        lessons: how many.
        updates: gradient steps after a lesson.
        last_updates: gradient steps at the end, in `parts`.
        parts: evaluations in these.
        batch_size: states in a gradient step.
        learning_rate: step size of Adam; at the end it falls to 0.
        episodes: of an evaluation.
    """

    num_envs: int = 64
    steps: int = 800
    lessons: int = 8
    updates: int = 1000
    last_updates: int = 12_000
    parts: int = 6
    batch_size: int = 512
    learning_rate: float = 4e-3
    episodes: int = 128


@dataclass(frozen=True)
class Student:
    """What a student meets and sees, and how it is taught.

    Attributes:
        randomization: where M and mu of its episodes come from.
        told: whether it observes them.
        rivals: policies that it is compared with.
        identifies: whether it identifies them on line.
        jump_rate: how often M and mu are drawn anew within a lesson, 1/s.
        margin: normal force that the teacher leaves, N: a student that does not know M needs more than it does.
        most_regret: what a torque costs at most, cm. The end of an episode costs more, and is as clear as that.
        budget: how much its run takes.
    """

    randomization: str
    told: bool
    rivals: tuple[str, ...]
    identifies: bool = False
    jump_rate: float = 0.0
    margin: float = MIN_NORMAL_FORCE
    most_regret: float = 5.0
    budget: Budget = Budget()

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the environment that it acts in."""
        return {"randomization": self.randomization, "observe_parameters": self.told}


# By their names, which those that are published have on the leaderboard; the teacher is the first rival.
STUDENTS = {
    "optimum-distilled": Student(
        "paper", False, ("optimum-oracle", "optimum-nominal", "residual-on-gait", "direct-ppo")
    ),
    "optimum-distilled-wide": Student(
        "wide",
        False,
        ("optimum-oracle", "robust", "direct-ppo-wide"),
        identifies=True,
        jump_rate=0.2,
        margin=0.4,
        most_regret=30.0,
        budget=Budget(num_envs=96, lessons=10, last_updates=24_000),
    ),
    "optimum-distilled-told": Student("wide", True, ("optimum-oracle", "robust", "direct-ppo-wide")),
}
