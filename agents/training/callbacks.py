"""Callbacks of Stable-Baselines3 for a run: its log, its evaluations and its progress bar."""

import copy
import math
import time
from collections.abc import Callable
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
from capsule_gym.envs.config import EnvConfig
from capsule_gym.evaluation.episodes import Episode, evaluate, scores, validation_set
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.evaluation.statistics import interquartile_mean
from capsule_gym.files import write_atomically
from capsule_gym.tasks.registry import find_task

# Far from the seeds 0, 1, .. of training runs and evaluation sets, so that no other plants select
# models.
SELECTION_SEED = 1_000_000
# Agent steps between two lines of the log of off-policy algorithms; on-policy algorithms log every
# rollout.
LOG_EVERY = 2_000


class Stopped(Exception):  # noqa: N818 (it is no error)
    """Ends a run between two updates, at the user's request."""


def validation_plants(config: Config) -> EvaluationSet:
    """The plants that select a run's best model: from its training ranges, with seeds that are used
    only for this.
    """
    first = SELECTION_SEED + config.seed * config.evaluation_episodes
    options = EnvConfig(**config.env_kwargs())
    name, count = f"validation plants from {config.randomization}", config.evaluation_episodes
    own = options.capsule, config.task, options.disturbances
    return validation_set(options.randomization, name, first, count, *own)


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
        self.run, self.config, self.revision = run, config, revision
        self.progress, self.latest, self.stop, self.restore_streams = (
            progress,
            latest,
            stop,
            restore_streams,
        )
        self.plants = validation_plants(config)
        self.criteria = CRITERIA[config.task]
        baseline = evaluate(self.criteria.baseline, self.plants)
        self.baseline_value = float(
            interquartile_mean(scores(baseline, self.criteria.metric.name))[0]
        )
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
        made = self.num_timesteps - self.training_env.num_envs
        if (
            isinstance(self.model, OffPolicyAlgorithm)
            and made // LOG_EVERY < self.num_timesteps // LOG_EVERY
        ):
            self.model.dump_logs()

    def _record_episodes(self) -> None:
        """Records the last episodes in the log and on the progress bar."""
        assert self.model.ep_info_buffer is not None
        config, task, criteria = self.config, find_task(self.config.task), self.criteria
        names = (
            "r",
            "distance",
            "energy",
            "cost_of_transport",
            "stuck_fraction",
            *criteria.weights,
        )
        of = {
            name: np.array([episode[name] for episode in self.model.ep_info_buffer])
            for name in names
        }
        # The terms of the reward; progress is the rest.
        failure = -config.termination_penalty * of["failed"]
        energy = -config.energy_weight * of["energy"]
        progress = of["r"] - energy - failure
        of |= dict(zip(task.reward_terms, (progress, energy, failure), strict=True))
        means = {name: float(of[name].mean()) for name in criteria.weights}
        for name, mean in means.items():
            self.logger.record(f"episodes/{name}", mean)
        # Medians, since a single episode without progress has an infinite cost.
        for name in ("cost_of_transport", "stuck_fraction", *task.reward_terms):
            if math.isfinite(median := float(np.median(of[name]))):
                self.logger.record(f"episodes/{name}", median)
        self.bar.set_postfix_str(criteria.describe(means), refresh=False)

    def _on_training_end(self) -> None:
        self.evaluate()

    def policy(self) -> Policy | None:
        """The current deterministic policy of the agent; None under wrappers."""
        return (
            None
            if self.config.wrapper
            else export(self.run.name, self.model, self.config, self.revision)
        )

    def evaluate(self) -> None:
        """Evaluates the deterministic policy; writes a line, a checkpoint, and the model if it is
        the best so far.
        """
        policy, criteria, plants = self.policy(), self.criteria, self.plants
        episodes = (
            evaluate(policy, plants)
            if policy
            else evaluate_wrapped(self.model, self.config, plants)
        )
        names = (*criteria.weights, "energy", "stuck_fraction")
        means = {name: float(scores(episodes, name).mean()) for name in names}
        score = (
            criteria.score(means)
            - self.config.energy_weight * means.pop("energy") / self.config.horizon
        )
        value, cost = (
            float(interquartile_mean(scores(episodes, name))[0])
            for name in (criteria.metric.name, "cost_of_transport")
        )
        values = means | {criteria.metric.name: value}
        for name, logged in (values | {"score": score, "cost_of_transport": cost}).items():
            if math.isfinite(logged):
                self.logger.record(f"evaluation/{name}", logged)
        self.evaluated_at = self.num_timesteps
        shares = {name: values[name] for name in criteria.weights if name != criteria.metric.name}
        line = {
            "steps": self.num_timesteps,
            "core_seconds": round(time.process_time() - self.core_began, 1),
        }
        line |= {
            criteria.column: round(value, 4),
            **shares,
            f"score_{criteria.suffix}": round(score, 4),
        }
        line[f"baseline_{criteria.column}"] = round(self.baseline_value, 4)
        self.progress.evaluations.append(line)
        lines = [",".join(map(str, line.values())) for line in self.progress.evaluations]
        write_atomically(
            self.run / EVALUATIONS, "\n".join([",".join(self.progress.evaluations[0]), *lines, ""])
        )
        reference = f"{criteria.baseline} {self.baseline_value:.2f} {criteria.unit}"
        self.bar.write(f"{self.num_timesteps:12,} steps: {criteria.describe(values)} ({reference})")
        if score > self.progress.best_score:
            self.progress.best_score = score
            save(self.run / BEST, self.model, policy)
        self.checkpoint()

    def checkpoint(self) -> None:
        """Writes a checkpoint, unless one exists for this step."""
        if self.latest == checkpoint.path_of(self.run, self.num_timesteps):
            return
        self.progress.core_seconds = time.process_time() - self.core_began
        self.latest = checkpoint.write(self.run, self.model, self.progress, before=self.latest)


def evaluate_wrapped(model: BaseAlgorithm, config: Config, plants: EvaluationSet) -> list[Episode]:
    """Runs an episode from rest on every plant, with the run's wrappers; returns the episodes as
    `evaluate` does.
    """
    settings, steps = (
        {**config.env_kwargs(), **plants.env_kwargs},
        round(config.horizon / config.control_dt),
    )
    venv = DummyVecEnv([lambda: wrapped_env(config, settings, steps)] * len(plants.plants))
    venv.seed(plants.plants[0].seed)
    venv.set_options([plant.reset_options() for plant in plants.plants])
    # Shares the statistics, which do not change.
    env = copy.copy(normalisation(model))
    env.set_venv(venv)
    env.training = False
    found: dict[int, Episode] = {}

    def keep(step: dict[str, Any], _: Any) -> None:
        if step["done"]:
            found[step["i"]] = step["info"]["metrics"]

    evaluate_policy(model, env, len(plants.plants), callback=keep, warn=False)
    env.close()
    return [
        {"M": each.M, "mu": each.mu, "seed": each.seed, **found[i]}
        for i, each in enumerate(plants.plants)
    ]
