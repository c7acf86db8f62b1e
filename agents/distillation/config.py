"""The students of the optimum: their observations, training episodes, and size of training."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from agents.criteria import CRITERIA
from capsule_gym import Disturbances, Fit, Randomization

# The key of a rig's own distribution in `Student.plants`.
RIG = "rig"


@dataclass(frozen=True, kw_only=True)
class Student:
    """The training episodes of a student, its network, and the size of its training.

    Attributes:
        randomization: distribution of the plants, for the environment of the policy.
        disturbances: disturbances of the environment.
        observation: further arguments of the environment, which determine the observation; with
            an identified rig also the `capsule`.
        groups: groups of training plants, which share a pendulum.
        plants: plants in a group, by the distribution of their M and mu.
        severities: sizes of the disturbances relative to "real" or those of the rig, and of the
            deviations of the pendulum, which the groups take in turn; None draws them.
        sticky_share: share of the groups with a static friction of 1.3 times the kinetic.
        change_rate: mean number of changes of M and mu per second of an episode, 1/s; the new
            values are of the group's plants of `wide`.
        margin: normal force (N) below which a torque costs more, up to `max_regret` at 0 N. A
            student that does not know M needs a larger margin than the expert.
        spare_share: share of the platform's weight beyond that of the lightest after a change that
            is added to `margin`: a change of M may take this weight away.
        max_regret: upper bound on the regret of a torque in the data, cm; the end of an episode
            would cost more.
        units: units of the GRU; 0 for a network without a memory.
        hidden: units of the hidden layers.
        num_envs: episodes in a round.
        steps: control steps in an episode.
        rounds: rounds of DAgger.
        updates: gradient steps after a round.
        final_updates: gradient steps of the final fit.
        final_parts: parts of the final fit; an evaluation follows each.
        batch_size: sequences in a gradient step.
        sequence: steps in a sequence.
        burn_in: first steps of a sequence that do not count, unless they begin an episode: the
            memory is empty there.
        learning_rate: step size of Adam at the start of a round's fit; the final fit begins with
            half of it, which falls to 0.
        validation: names of the sets after which the validation plants are drawn.
        evaluation_episodes: episodes in an evaluation on each of them.
        failure_cost: weight of the share of failed episodes in the selection of the best policy,
            cm/s.
    """

    randomization: str | Randomization
    disturbances: str | Disturbances = "none"
    observation: Mapping[str, Any] = field(default_factory=dict)
    groups: int
    plants: Mapping[str, int]
    severities: tuple[float | None, ...]
    sticky_share: float = 0.0
    change_rate: float = 0.0
    margin: float
    spare_share: float = 0.0
    max_regret: float = 60.0
    units: int = 0
    hidden: int = 64
    num_envs: int
    steps: int = 800
    rounds: int = 10
    updates: int
    final_updates: int
    final_parts: int = 4
    batch_size: int
    sequence: int = 1
    burn_in: int = 0
    learning_rate: float
    validation: tuple[str, ...]
    evaluation_episodes: int = 128
    failure_cost: float = -CRITERIA["speed"].weights["failed"]

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the student's environment."""
        return {
            "randomization": self.randomization,
            "disturbances": self.disturbances,
            **self.observation,
        }


def for_rig(student: Student, fit: Fit) -> Student:
    """A student whose plants and disturbances are drawn from the intervals of an identified rig.

    A rig does not change during an episode.
    """
    options = fit.env_kwargs()
    return replace(
        student,
        randomization=options["randomization"],
        disturbances=options["disturbances"],
        observation={**student.observation, "capsule": options["capsule"]},
        plants={RIG: 1},
        severities=(1.0,),
        sticky_share=0.0,
        change_rate=0.0,
        spare_share=0.0,
    )


# Keys are names of rows on the leaderboard.
STUDENTS = {
    # Perfect sensors, and the estimates of the filter instead of a memory.
    "dp-distilled-wide": Student(
        randomization="broad",
        observation={"observe_estimates": True},
        groups=8,
        plants={"wide": 4, "broad": 4},
        severities=(0.0,),
        change_rate=0.2,
        margin=0.5,
        spare_share=0.6,
        num_envs=96,
        updates=1000,
        final_updates=24_000,
        batch_size=512,
        learning_rate=4e-3,
        validation=("wide",),
    ),
    # All plants and all disturbances at once.
    "dp-distilled": Student(
        randomization="broad",
        disturbances="real",
        groups=24,
        plants={"wide": 3, "broad": 2, "sticky": 1, "paper": 2},
        severities=(1.0, 0.0, 1.0, None),
        sticky_share=0.5,
        change_rate=0.1,
        margin=0.5,
        spare_share=0.6,
        units=96,
        num_envs=192,
        updates=320,
        final_updates=4600,
        batch_size=64,
        sequence=100,
        burn_in=16,
        learning_rate=2e-3,
        validation=("paper", "wide", "real", "real-wide", "sticky"),
        evaluation_episodes=64,
    ),
    # For the ranges of `real`, where M and mu vary little.
    "dp-distilled-real": Student(
        randomization="real",
        disturbances="real",
        groups=128,
        plants={"real": 1},
        severities=(1.0, 1.0, 1.0, None),
        margin=0.5,
        units=64,
        num_envs=96,
        updates=450,
        final_updates=4800,
        batch_size=64,
        sequence=100,
        burn_in=16,
        learning_rate=2e-3,
        validation=("real",),
        evaluation_episodes=512,
    ),
}
