"""Callbacks of Stable-Baselines3 for a run: its log, its evaluations and its progress bar."""

import copy
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv
from tqdm import tqdm

from agents.criteria import CRITERIA
from agents.training import checkpoint
from agents.training.algorithms import wrapped_env
from agents.training.checkpoint import Progress
from agents.training.config import BEST, EVALUATIONS, Config
from agents.training.export import export, normalisation, save
from agents.training.signals import Stop
from capsule_gym import Policy
from capsule_gym.evaluation.episodes import Episode, drawn_from, evaluate, scores
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.evaluation.statistics import interquartile_mean
from capsule_gym.files import write_atomically
from capsule_gym.tasks.registry import find_task

# Far from the seeds 0, 1, .. of training runs and evaluation sets.
SELECTION_SEED = 1_000_000
# Agent steps between two lines of the log of off-policy algorithms; on-policy algorithms log every
# rollout.
LOG_EVERY = 2_000


class Stopped(Exception):  # noqa: N818 (it is no error)
    """Ends a run between two updates, at the user's request."""


def validation_plants(config: Config) -> EvaluationSet:
    """The plants that select a run's best model, from its training ranges.

    Their seeds are used only for this.
    """
    count = config.evaluation_episodes
    name = f"validation plants from {config.randomization}"
    return drawn_from(config.env_kwargs(), name, SELECTION_SEED + config.seed * count, count)


class TrainingCallback(BaseCallback):
    """Progress bar, log, evaluations on validation plants, checkpoints and the best model.

    `restore_streams` is called when the agent begins to learn; `latest` is the checkpoint from
    which the run is resumed, if any, and `revision` the git revision of its start.
    """

    def __init__(
        self,
        run: Path,
        config: Config,
        progress: Progress,
        latest: Path | None,
        restore_streams: Callable[[], None],
        stop: Stop,
        revision: str,
    ) -> None:
        super().__init__()
        self.run = run
        self.config = config
        self.revision = revision
        self.progress = progress
        self.latest = latest
        self.stop = stop
        self.restore_streams = restore_streams
        self.plants = validation_plants(config)
        self.criteria = CRITERIA[config.task]
        baseline = evaluate(self.criteria.baseline, self.plants)
        self.baseline_value = _interquartile_mean(baseline, self.criteria.metric.name)
        self.evaluated_at = int(progress.evaluations[-1]["steps"]) if progress.evaluations else 0
        self.core_began = time.process_time() - progress.core_seconds
        # The bar is shown only on a terminal; evaluations are always printed.
        self.bar = tqdm(
            total=config.total_steps,
            initial=self.evaluated_at,
            unit=" steps",
            unit_scale=True,
            disable=None,
        )

    def _on_training_start(self) -> None:
        self.restore_streams()

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]):
            info = self.locals["infos"][i]
            # SB3 keeps "episode" for the last episodes, also in checkpoints.
            info["episode"] |= info["metrics"]
        # The last rollout exceeds the total; a bar beyond its total shows no percentage.
        self.bar.update(min(self.num_timesteps, self.config.total_steps) - self.bar.n)
        return True

    def _on_rollout_start(self) -> None:
        # Between two updates, so that a checkpoint holds a consistent model.
        if self.num_timesteps - self.evaluated_at >= self.config.evaluate_every:
            self.evaluate()
        if self.stop.requested:
            raise Stopped

    def _on_rollout_end(self) -> None:
        if self.model.ep_info_buffer:
            self._record_episodes()
        # SB3 logs off-policy algorithms at the ends of episodes, and all episodes end at the same
        # time.
        if isinstance(self.model, OffPolicyAlgorithm):
            before = self.num_timesteps - self.training_env.num_envs
            if before // LOG_EVERY < self.num_timesteps // LOG_EVERY:
                self.model.dump_logs()

    def _record_episodes(self) -> None:
        """Records the last episodes in the log and on the progress bar."""
        episodes: Any = self.model.ep_info_buffer

        def values(name: str) -> np.ndarray:
            return np.array([episode[name] for episode in episodes])

        means = {name: float(values(name).mean()) for name in self.criteria.weights}
        for name, mean in means.items():
            self.logger.record(f"episodes/{name}", mean)
        # The terms of the reward; progress is the rest.
        failure = -self.config.termination_penalty * values("failed")
        energy = -self.config.energy_weight * values("energy")
        progress = values("r") - energy - failure
        names = find_task(self.config.task).reward_terms
        shown = {name: values(name) for name in ("cost_of_transport", "stuck_fraction")}
        shown |= zip(names, (progress, energy, failure), strict=True)
        # Medians, since a single episode without progress has an infinite cost.
        for name, column in shown.items():
            median = float(np.median(column))
            if math.isfinite(median):
                self.logger.record(f"episodes/{name}", median)
        self.bar.set_postfix_str(self.criteria.describe(means), refresh=False)

    def _on_training_end(self) -> None:
        self.evaluate()

    def policy(self) -> Policy | None:
        """The current deterministic policy of the agent; None under wrappers."""
        if self.config.wrapper:
            return None
        return export(self.run.name, self.model, self.config, self.revision)

    def evaluate(self) -> None:
        """Evaluates the deterministic policy.

        Writes a line, a checkpoint, and the model if it is the best so far.
        """
        policy = self.policy()
        if policy is None:
            episodes = evaluate_wrapped(self.model, self.config, self.plants)
        else:
            episodes = evaluate(policy, self.plants)
        self.evaluated_at = self.num_timesteps
        criteria = self.criteria
        values = {name: _mean(episodes, name) for name in (*criteria.weights, "stuck_fraction")}
        energy = self.config.energy_weight * _mean(episodes, "energy")
        score = criteria.score(values) - energy / self.config.horizon
        values[criteria.metric.name] = _interquartile_mean(episodes, criteria.metric.name)
        cost = _interquartile_mean(episodes, "cost_of_transport")
        for name, value in {**values, "score": score, "cost_of_transport": cost}.items():
            if math.isfinite(value):
                self.logger.record(f"evaluation/{name}", value)
        self._write_line(values, score)
        reference = f"{criteria.baseline} {self.baseline_value:.2f} {criteria.unit}"
        self.bar.write(f"{self.num_timesteps:12,} steps: {criteria.describe(values)} ({reference})")
        if score > self.progress.best_score:
            self.progress.best_score = score
            save(self.run / BEST, self.model, policy)
        self.checkpoint()

    def _write_line(self, values: Mapping[str, float], score: float) -> None:
        """Adds a line to evaluations.csv."""
        criteria = self.criteria
        line: dict[str, float] = {
            "steps": self.num_timesteps,
            "core_seconds": round(time.process_time() - self.core_began, 1),
            criteria.column: round(values[criteria.metric.name], 4),
        }
        for name in criteria.weights:
            if name != criteria.metric.name:
                line[name] = values[name]
        line[f"score_{criteria.suffix}"] = round(score, 4)
        line[f"baseline_{criteria.column}"] = round(self.baseline_value, 4)
        self.progress.evaluations.append(line)
        lines = [",".join(self.progress.evaluations[0])]
        lines += [",".join(map(str, each.values())) for each in self.progress.evaluations]
        write_atomically(self.run / EVALUATIONS, "\n".join([*lines, ""]))

    def checkpoint(self) -> None:
        """Writes a checkpoint, unless one exists for this step."""
        if self.latest == checkpoint.path_of(self.run, self.num_timesteps):
            return
        self.progress.core_seconds = time.process_time() - self.core_began
        self.latest = checkpoint.write(self.run, self.model, self.progress, before=self.latest)


def _mean(episodes: list[Episode], metric: str) -> float:
    """The mean of a metric."""
    return float(scores(episodes, metric).mean())


def _interquartile_mean(episodes: list[Episode], metric: str) -> float:
    """The interquartile mean of a metric."""
    return float(interquartile_mean(scores(episodes, metric))[0])


def evaluate_wrapped(model: BaseAlgorithm, config: Config, plants: EvaluationSet) -> list[Episode]:
    """Runs an episode from rest on every plant, with the run's wrappers.

    Returns:
        The episodes as `evaluate` does.
    """
    settings = {**config.env_kwargs(), **plants.env_kwargs}
    steps = round(config.horizon / config.control_dt)
    venv = DummyVecEnv([lambda: wrapped_env(config, settings, steps)] * len(plants.plants))
    venv.seed(plants.plants[0].seed)
    venv.set_options([plant.reset_options() for plant in plants.plants])
    # Shares the statistics, which do not change.
    env = copy.copy(normalisation(model))
    env.set_venv(venv)
    env.training = False
    episodes = [{"M": plant.M, "mu": plant.mu, "seed": plant.seed} for plant in plants.plants]

    def keep(step: dict[str, Any], _: Any) -> None:
        if step["done"]:
            episodes[step["i"]] |= step["info"]["metrics"]

    evaluate_policy(model, env, len(plants.plants), callback=keep, warn=False)
    env.close()
    return episodes
