"""What is compared: agents of one budget, on several laws, with more or less torque of their own, learning two ways."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from agents.evaluation.sets import validation_set
from agents.study.jobs import Job, refuse_other_settings
from agents.training.presets import ROWS, Config
from baselines.policies import SCRIPTED
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.task import TORQUE_LIMIT

Plants = Literal["paper", "wide"]

# N m; twice the torque limit is full authority.
LIMITS = (0.75, 2.0 * TORQUE_LIMIT)
# By the scripted policy that is the law alone: what it is called, and the plants that it is examined on.
BASES: dict[str, tuple[str, tuple[Plants, ...]]] = {
    "adaptive": ("stiff", ("paper",)),
    "compliant": ("compliant", ("paper",)),
    "gait-guarded": ("gait", ("paper", "wide")),
}
# The same budget without any law, in the settings that were made for that.
DIRECT: dict[Plants, str] = {"paper": "direct-ppo", "wide": "direct-ppo-wide"}
# What all others are trained with, but for the law, its limit, the plants and the budget: by its name a row of the
# leaderboard. One was made to keep what a base can do; the other is how agents without a base learn.
Recipe = Literal["cautious", "bold"]
RECIPES: dict[Recipe, str] = {"cautious": "residual-on-gait", "bold": "direct-ppo"}
STEPS = 1_000_000
EVALUATIONS = 5
SEEDS = (0, 1, 2)
EPISODES = 256
# Of the plants that all are judged on: far from those of training, of a run's selection and of the frozen sets.
FIRST_SEED = 3_000_000


@dataclass(frozen=True, order=True)
class Arm:
    """One kind of agent.

    Attributes:
        base: a scripted policy whose law runs inside the step; "" for none.
        plants: where M and mu come from, in training and in judgement.
        limit: of the agent's torque, N m; 0.0 for the law alone.
        recipe: how it learns; "" where it does not, or without a law.
    """

    base: str
    plants: Plants
    limit: float
    recipe: Recipe | Literal[""] = ""

    @property
    def name(self) -> str:
        """As it appears in folders and progress."""
        return "-".join(filter(None, (self.base or "direct", self.plants, f"{self.limit:g}", self.recipe)))

    @property
    def label(self) -> str:
        """The base, as tables call it."""
        return BASES[self.base][0] if self.base else "none (direct)"

    @property
    def alone(self) -> Arm:
        """Its law without an agent."""
        return Arm(self.base, self.plants, 0.0)

    def config(self, seed: int, steps: int) -> Config:
        """What a run of it is trained with."""
        shared: dict[str, Any] = {"seed": seed, "total_steps": steps, "evaluate_every": max(1, steps // EVALUATIONS)}
        if not self.recipe:
            return dataclasses.replace(ROWS[DIRECT[self.plants]], **shared)
        law = SCRIPTED[self.base].env_kwargs["controller"]
        shared |= {"controller": law, "residual_limit": self.limit, "randomization": self.plants}
        return dataclasses.replace(ROWS[RECIPES[self.recipe]], task="residual", **shared)


def all_arms() -> list[Arm]:
    """Every kind of agent that learns, base by base."""
    residual = [
        Arm(base, each, limit, recipe)
        for base, (_, plants) in BASES.items()
        for each in plants
        for recipe in RECIPES
        for limit in LIMITS
    ]
    return [*residual, *(direct(each) for each in DIRECT)]


def direct(plants: Plants) -> Arm:
    """Agents without a law, whose torque is the motor's."""
    return Arm("", plants, TORQUE_LIMIT)


def plan(arms: Sequence[Arm], seeds: Sequence[int], steps: int, folder: Path) -> dict[Job, Arm]:
    """The runs, seed by seed, so that all kinds have their first seeds first.

    Args:
        arms: the kinds.
        seeds: training seeds.
        steps: of each run.
        folder: of all of them; a run is in ARM/seed-N.

    Raises:
        RunError: if a folder is there and holds no run, or one of other settings.
    """
    jobs = {
        Job(arm.name, arm.config(seed, steps), folder / arm.name / f"seed-{seed}"): arm
        for seed in seeds
        for arm in arms
    }
    for job in jobs:
        if job.run.exists():
            refuse_other_settings(job)
    return jobs


def own_plants(plants: Plants) -> EvaluationSet:
    """The episodes that all are judged on."""
    return validation_set(plants, f"authority, {plants}", FIRST_SEED, EPISODES)
