"""Trainings with their learning curves, and the processor time that they take."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback

from agents.evaluation.episodes import evaluate, scores
from agents.evaluation.statistics import interquartile_mean
from agents.training.export import export
from agents.training.loop import own_draws
from agents.training.runs import git_revision
from benchmarks.trainers import Run, Trainer
from benchmarks.training_turns import training, unit
from capsule_gym.evaluation_sets import EvaluationSet

# Of the plants that all are evaluated on: no run selects on them, no frozen set holds them.
DRAWS = 4_000


class Curve(BaseCallback):
    """Evaluates the deterministic policy between updates, and stops the clock meanwhile.

    Args:
        trainer: what trains.
        every: environment steps between evaluations.
        draws: the plants.
    """

    def __init__(self, trainer: Trainer, every: int, draws: EvaluationSet) -> None:
        super().__init__()
        self.trainer, self.every, self.draws = trainer, every, draws
        self.run = Run(trainer.name, trainer.config.seed)

    def _on_training_start(self) -> None:
        self.began = time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - (self.run.steps[-1] if self.run.steps else 0) >= self.every:
            self.evaluate()

    def _on_training_end(self) -> None:
        self.evaluate()

    def evaluate(self) -> None:
        """Adds a point to the curve."""
        now = time.process_time()
        config = self.trainer.config
        policy = export(
            self.trainer.name,
            self.model,
            env_kwargs=config.env_kwargs(),
            training_seed=config.seed,
            revision=git_revision(Path(__file__).parent),
        )
        episodes = evaluate(policy, self.draws)
        self.run.steps.append(self.num_timesteps)
        self.run.seconds.append(round(now - self.began, 3))
        self.run.mean_speed.append(round(float(interquartile_mean(scores(episodes, "mean_speed"))[0]), 4))
        self.run.failed.append(float(scores(episodes, "failed").mean()))
        self.began += time.process_time() - now


def warm_up(trainer: Trainer) -> None:
    """Compiles what the training needs, or reads it from the cache; before a clock runs."""
    with training(trainer) as model:
        model.learn(unit(model))


def train(trainer: Trainer, every: int) -> Run:
    """Trains for `total_steps` and evaluates on the way.

    Args:
        trainer: what trains, and its seed.
        every: environment steps between evaluations.
    """
    draws = own_draws(dataclasses.replace(trainer.config, seed=DRAWS))
    curve = Curve(trainer, every, draws)
    with training(trainer) as model:
        model.learn(trainer.config.total_steps, callback=curve)
    return curve.run
