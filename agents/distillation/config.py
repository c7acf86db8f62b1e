"""The students of the optimum: what each observes, the episodes it is trained on, and the size of its training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from agents.evaluation.criteria import CRITERIA
from baselines.archive import GRID, STICKY_GRID, PlantGrid
from baselines.dynamic_programming import MIN_NORMAL_FORCE
from capsule_gym.parameters import NOMINAL


@dataclass(frozen=True)
class Student:
    """The observations of a student, its training episodes, and the size of its training.

    Attributes:
        randomization: the distribution of M and mu.
        grid: the plants that the expert's solutions are of, with the plants' static ratio.
        identifies: whether it identifies them on line.
        change_rate: how often M and mu are drawn anew within an episode, 1/s.
        change_randomization: the distribution of M and mu after a change; `randomization` where it is None.
        law: the name of a control law that its torque is added to, and the limit on its torque, N m.
        margin: normal force below which a torque costs more, up to `max_regret` at 0 N: a student that does not know
            M needs more than the expert.
        deviations: standard deviations of the estimated weight of the platform that are added to `margin`.
        max_regret: largest regret of a torque in the data, cm. The end of an episode costs more.
        num_envs: episodes of a round.
        steps: of each episode.
        rounds: rounds of DAgger.
        updates: gradient steps after a round.
        final_updates: gradient steps at the end, in `final_parts`.
        final_parts: evaluations in these.
        batch_size: states in a gradient step.
        learning_rate: step size of Adam; it falls to 0 at the end.
        evaluation_episodes: of an evaluation.
        failure_cost: cm/s that the share of failed episodes costs where the best policy is chosen.
    """

    randomization: str
    grid: PlantGrid = GRID
    identifies: bool = False
    change_rate: float = 0.0
    change_randomization: str | None = None
    law: tuple[str, float] | None = None
    margin: float = MIN_NORMAL_FORCE
    deviations: float = 0.0
    max_regret: float = 5.0
    num_envs: int = 64
    steps: int = 800
    rounds: int = 8
    updates: int = 1000
    final_updates: int = 12_000
    final_parts: int = 6
    batch_size: int = 512
    learning_rate: float = 4e-3
    evaluation_episodes: int = 128
    failure_cost: float = -CRITERIA["speed"].weights["failed"]

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the environment that it acts in."""
        own: dict[str, Any] = {"capsule": self.grid.capsule} if self.grid.capsule != NOMINAL else {}
        if self.law:
            own |= {"controller": self.law[0], "residual_limit": self.law[1]}
        return {"randomization": self.randomization, "observe_parameters": False, **own}


# By the name of their rows on the leaderboard.
STUDENTS = {
    "dp-distilled": Student("paper"),
    "dp-distilled-wide": Student(
        "broad",
        identifies=True,
        change_rate=0.2,
        change_randomization="wide",
        margin=0.5,
        deviations=2.0,
        max_regret=60.0,
        num_envs=96,
        rounds=10,
        final_updates=60_000,
    ),
    "residual-distilled-wide": Student(
        "broad",
        identifies=True,
        change_rate=0.2,
        change_randomization="wide",
        law=("baselines:gait_identifying", 2.0),
        margin=0.4,
        deviations=2.0,
        max_regret=60.0,
        num_envs=48,
        final_parts=3,
    ),
    "sticky": Student(
        "sticky",
        grid=STICKY_GRID,
        identifies=True,
        margin=1.0,
        deviations=1.0,
        max_regret=100.0,
        num_envs=320,
        steps=250,
        rounds=10,
        evaluation_episodes=512,
        failure_cost=1000.0,
    ),
}
