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
        grid: the plants for which the expert is solved, with their static ratio.
        identifies: whether the student observes online estimates of M and mu.
        change_rate: mean number of changes of M and mu per second of an episode, 1/s.
        change_randomization: the distribution of M and mu after a change; None takes `randomization`.
        law: the name of the control law to which the student adds its torque, and the limit on that torque, N m;
            None for direct torque.
        margin: normal force (N) below which a torque costs more, up to `max_regret` at 0 N. A student that does not
            know M needs a larger margin than the expert.
        deviations: number of standard deviations of the platform's estimated weight that are added to `margin`.
        max_regret: upper bound on the regret of a torque in the data, cm; the end of an episode would cost more.
        num_envs: episodes in a round.
        steps: control steps in an episode.
        rounds: rounds of DAgger.
        updates: gradient steps after a round.
        final_updates: gradient steps of the final fit.
        final_parts: parts of the final fit; an evaluation follows each.
        batch_size: states in a gradient step.
        learning_rate: step size of Adam; it falls to 0 at the end.
        evaluation_episodes: episodes in an evaluation.
        failure_cost: weight of the share of failed episodes in the selection of the best policy, cm/s.
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
        """The arguments of the student's environment."""
        own: dict[str, Any] = {"capsule": self.grid.capsule} if self.grid.capsule != NOMINAL else {}
        if self.law:
            own |= {"controller": self.law[0], "residual_limit": self.law[1]}
        return {"randomization": self.randomization, "observe_parameters": False, **own}


_WIDE: dict[str, Any] = {"identifies": True, "change_rate": 0.2, "change_randomization": "wide", "deviations": 2.0}
_STICKY: dict[str, Any] = {
    **{"grid": STICKY_GRID, "identifies": True, "margin": 1.0, "deviations": 1.0, "max_regret": 100.0},
    **{"num_envs": 320, "steps": 250, "rounds": 10, "evaluation_episodes": 512, "failure_cost": 1000.0},
}
# Keys are names of rows on the leaderboard.
STUDENTS = {
    "dp-distilled": Student("paper"),
    "dp-distilled-wide": Student(
        "broad", **_WIDE, margin=0.5, max_regret=60.0, num_envs=96, rounds=10, final_updates=60_000
    ),
    "residual-distilled-wide": Student(
        "broad",
        law=("baselines:gait_identifying", 2.0),
        **_WIDE,
        margin=0.4,
        max_regret=60.0,
        num_envs=48,
        final_parts=3,
    ),
    "sticky": Student("sticky", **_STICKY),
}
