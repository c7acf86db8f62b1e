"""The students of the optimum: their observations, training episodes, and size of training."""

from dataclasses import dataclass
from typing import Any

from agents.criteria import CRITERIA
from capsule_gym.evaluation.optimum import GRID, STICKY_GRID, PlantGrid
from capsule_gym.parameters import NOMINAL


@dataclass(frozen=True)
class Student:
    """The training episodes of a student, and the size of its training.

    A student observes online estimates of M and mu.

    Attributes:
        randomization: the distribution of M and mu.
        grid: the plants for which the expert is solved, with their static ratio.
        change_rate: mean number of changes of M and mu per second of an episode, 1/s; the new
            values are of `wide`.
        margin: normal force (N) below which a torque costs more, up to `max_regret` at 0 N. A
            student that does not know M needs a larger margin than the expert.
        deviations: number of standard deviations of the platform's estimated weight that are added
            to `margin`.
        max_regret: upper bound on the regret of a torque in the data, cm; the end of an episode
            would cost more.
        num_envs: episodes in a round.
        steps: control steps in an episode.
        rounds: rounds of DAgger.
        updates: gradient steps after a round.
        final_updates: gradient steps of the final fit.
        final_parts: parts of the final fit; an evaluation follows each.
        batch_size: states in a gradient step.
        learning_rate: step size of Adam; it falls to 0 at the end.
        evaluation_episodes: episodes in an evaluation.
        failure_cost: weight of the share of failed episodes in the selection of the best policy,
            cm/s.
    """

    randomization: str
    grid: PlantGrid
    change_rate: float
    margin: float
    deviations: float
    max_regret: float
    num_envs: int
    steps: int
    final_updates: int
    evaluation_episodes: int
    failure_cost: float
    rounds: int = 10
    updates: int = 1000
    final_parts: int = 6
    batch_size: int = 512
    learning_rate: float = 4e-3

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the student's environment."""
        kwargs: dict[str, Any] = {
            "randomization": self.randomization,
            "observe_estimates": True,
            "observe_parameters": False,
        }
        if self.grid.capsule != NOMINAL:
            kwargs["capsule"] = self.grid.capsule
        return kwargs


_WIDE = Student(
    randomization="broad",
    grid=GRID,
    change_rate=0.2,
    margin=0.5,
    deviations=2.0,
    max_regret=60.0,
    num_envs=96,
    steps=800,
    final_updates=60_000,
    evaluation_episodes=128,
    failure_cost=-CRITERIA["speed"].weights["failed"],
)
_STICKY = Student(
    randomization="sticky",
    grid=STICKY_GRID,
    change_rate=0.0,
    margin=1.0,
    deviations=1.0,
    max_regret=100.0,
    num_envs=320,
    steps=250,
    final_updates=12_000,
    evaluation_episodes=512,
    failure_cost=1000.0,
)
# Keys are names of rows on the leaderboard.
STUDENTS = {"dp-distilled-wide": _WIDE, "sticky": _STICKY}
