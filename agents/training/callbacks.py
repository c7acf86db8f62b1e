"""What happens while a run trains: its log, its evaluations and its progress bar, as callbacks of Stable-Baselines3.

A resumed run trains a part again, from its last checkpoint on. The log's lines of that part are deleted first, so that
each stands once.
"""

from __future__ import annotations

import csv
import io
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat, filter_excluded_keys
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from agents.evaluation.episodes import Episode, evaluate, scores
from agents.evaluation.policies import BASELINE, Policy
from agents.evaluation.sets import validation_set
from agents.evaluation.statistics import interquartile_mean
from agents.training import checkpoint
from agents.training.algorithms import wrapped_env
from agents.training.checkpoint import Progress
from agents.training.export import export, present_policy, save
from agents.training.presets import BEST, EVALUATED, EVALUATIONS, LOG, LOGGED, LOGS, Config, RunError
from agents.training.signals import Stop
from baselines.policies import SCRIPTED
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, EvaluationSet
from capsule_gym.files import canonical_hash, synchronise, write_atomically
from capsule_gym.task import CONTROL_DT, HORIZON

# Far from the seeds 0, 1, .. of training runs and evaluation sets: models are selected on plants of their own.
SELECTION_SEED = 1_000_000
# The best model has the largest mean speed less what its power costs, less this (cm/s) times its share of failures.
FAILURE_COST = 30.0
# Agent steps between two lines of the log of off-policy algorithms; the others write one per rollout.
LOG_EVERY = 2_000
# Episodes that the progress bar's mean speed is over.
RECENT = 128
# The project's name at Weights & Biases.
PROJECT = "capsule_gym"


# --- the log ---------------------------------------------------------------------------------------------------------


class Table(KVWriter):
    """A CSV file of lines with a count of agent steps; also a writer of SB3's logger, whose own cannot continue a file.

    Args:
        path: the file; the lines that it has stay.
        steps: the column of the agent steps.
        until: lines with more steps are deleted, and a last one that is not complete.
    """

    def __init__(self, path: Path, steps: str, until: int) -> None:
        self.path = path
        self.columns: list[str] = []
        if path.is_file():
            rows = self._read()
            if steps in self.columns:
                self._rewrite([row for row in rows if row[steps].isdecimal() and int(row[steps]) <= until])
            else:
                self.columns = []

    def add(self, row: Mapping[str, Any]) -> None:
        """Adds a line; a new column is empty in the lines before."""
        new = [name for name in row if name not in self.columns]
        if new:
            before = self._read() if self.columns else []
            self.columns += new
            self._rewrite(before)
        with self.path.open("a", newline="", encoding="utf-8") as file:
            self._writer(file).writerow(row)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """A line of SB3's logger."""
        self.add(filter_excluded_keys(key_values, key_excluded, "csv"))

    def close(self) -> None:
        """Does nothing: the file is closed between two lines."""

    def synchronise(self) -> None:
        """Waits until all lines are on the disk."""
        if self.path.is_file():
            synchronise(self.path)

    def _writer(self, file: Any) -> csv.DictWriter[str]:
        return csv.DictWriter(file, self.columns, lineterminator="\n")

    def _read(self) -> list[dict[str, str]]:
        """The complete lines."""
        text = self.path.read_text(encoding="utf-8", errors="replace")
        reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1], newline=""))
        self.columns = list(reader.fieldnames or ())
        return [row for row in reader if None not in row and None not in row.values()]

    def _rewrite(self, rows: Sequence[Mapping[str, Any]]) -> None:
        text = io.StringIO(newline="")
        writer = self._writer(text)
        writer.writeheader()
        writer.writerows(rows)
        write_atomically(self.path, text.getvalue())


class Events(TensorBoardOutputFormat):
    """TensorBoard's events; those of earlier processes are hidden from the step `until` + 1 on.

    Args:
        folder: the folder of the files.
        until: agent steps so far.
    """

    def __init__(self, folder: Path, until: int) -> None:
        self.writer = SummaryWriter(folder, purge_step=until + 1)
        self._is_closed = False


@contextmanager
def quiet_tensorboard() -> Iterator[None]:
    """Prints no traceback of an OSError in TensorBoard's thread, which raises it again at the next write."""
    before = threading.excepthook

    def hook(failure: threading.ExceptHookArgs) -> None:
        if not (isinstance(failure.exc_value, OSError) and type(failure.thread).__module__.startswith("tensorboard.")):
            before(failure)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


class WandbWriter(KVWriter):
    """Writes the lines of SB3's logger to Weights & Biases, by agent steps.

    Args:
        run: the run's folder, whose name it has there.
        config: its hyperparameters.

    Raises:
        RunError: if wandb is not installed, or does not start.
    """

    def __init__(self, run: Path, config: dict[str, Any]) -> None:
        try:
            import wandb
        except ImportError:
            raise RunError('--wandb needs wandb: pip install "capsule-gym[wandb]"') from None
        (run / LOGS).mkdir(exist_ok=True)
        # The same folder with the same settings is the same run, resumed.
        identity = canonical_hash([str(run.resolve()), {**config, "total_steps": None}])[:16]
        try:
            self._run = wandb.init(
                project=PROJECT, name=run.name, id=identity, resume="allow", config=config, dir=run / LOGS
            )
        except wandb.errors.Error as error:
            raise RunError(f"--wandb: {error}") from error

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Writes a line of SB3's logger."""
        self._run.log(filter_excluded_keys(key_values, key_excluded, "wandb"), step=step)

    def close(self) -> None:
        """Ends the run there."""
        self._run.finish()


def make_logger(run: Path, config: Config, until: int, wandb: bool) -> Logger:
    """SB3's logger of a run that starts or resumes at that many agent steps.

    Raises:
        RunError: if Weights & Biases is asked for and cannot be used.
    """
    folder = run / LOGS
    folder.mkdir(exist_ok=True)
    # First: if it fails, the files are as they were.
    online: list[KVWriter] = [WandbWriter(run, config.to_dict())] if wandb else []
    return Logger(str(folder), [Table(folder / LOG, LOGGED, until), Events(folder, until), *online])


# --- the callback ----------------------------------------------------------------------------------------------------


class Stopped(Exception):  # noqa: N818
    """Ends a run between two updates, because its user asked for it."""


class Bar(tqdm):
    """A progress bar on a terminal; elsewhere lines, which a file can hold."""

    @staticmethod
    def status_printer(file: Any) -> Callable[[str], None]:
        """The function that shows the text of the bar."""
        if file.isatty():
            return cast("Callable[[str], None]", tqdm.status_printer(file))
        return lambda text: print(text.rstrip(), file=file, flush=True)


def validation_plants(config: Config) -> EvaluationSet:
    """The plants that a run selects its best model on: from its training ranges, with seeds that nothing else uses."""
    first = SELECTION_SEED + config.seed * config.evaluation_episodes
    name = f"validation plants from {config.randomization}"
    return validation_set(config.randomization, name, first, config.evaluation_episodes)


class TrainingCallback(BaseCallback):
    """Progress bar, log, evaluations on validation plants, checkpoints and the best model.

    Args:
        run: the run's folder.
        config: its configuration.
        progress: how far it is.
        latest: the checkpoint that it is resumed from, None for none.
        stop: whether it is to end.
        revision: the git revision that it was started at.
    """

    def __init__(
        self, run: Path, config: Config, progress: Progress, latest: Path | None, stop: Stop, revision: str
    ) -> None:
        super().__init__()
        self.run, self.config, self.revision = run, config, revision
        self.progress, self.latest, self.stop = progress, latest, stop
        self.plants = validation_plants(config)
        baseline = evaluate(SCRIPTED[BASELINE], self.plants)
        self.baseline_speed = float(interquartile_mean(scores(baseline, "mean_speed"))[0])
        self.evaluations = Table(run / EVALUATIONS, EVALUATED, progress.evaluated_at)
        self.bar: tqdm[Any] = tqdm(disable=True)

    def _on_training_start(self) -> None:
        self.began = time.monotonic() - self.progress.elapsed
        self.core_began = time.process_time() - self.progress.core_seconds
        self.bar = Bar(
            total=self.config.total_steps,
            initial=self._shown_steps(),
            unit=" steps",
            unit_scale=True,
            smoothing=0.05,
            mininterval=0.5 if sys.stderr.isatty() else 10.0,
            dynamic_ncols=True,
        )

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "metrics" in info:
                self._remember(info["metrics"], info["episode"]["r"])
        self.bar.update(self._shown_steps() - self.bar.n)
        return True

    def _shown_steps(self) -> int:
        """At most the total, which the last rollout exceeds: the bar would lose its percentage."""
        return min(self.num_timesteps, self.config.total_steps)

    def _remember(self, metrics: dict[str, float], total: float) -> None:
        """Keeps the metrics of an episode that has ended; the terms of its reward are in cm, as `total` is."""
        self.progress.speeds.append(metrics["mean_speed"])
        self.progress.failed.append(metrics["failed"])
        progress, failure = 100.0 * metrics["distance"], -self.config.termination_penalty * metrics["failed"]
        shown = {
            "cost_of_transport": metrics["cost_of_transport"],
            "stuck_fraction": metrics["stuck_fraction"],
            "reward_progress": progress,
            # The rest, since the energy weight may be another in every episode.
            "reward_energy": total - progress - failure,
            "reward_termination": failure,
        }
        for name, value in shown.items():
            self.progress.recent.setdefault(name, []).append(value if math.isfinite(value) else None)

    def _on_rollout_start(self) -> None:
        # Between updates, so that a checkpoint holds a consistent model.
        if self.num_timesteps - self.progress.evaluated_at >= self.config.evaluate_every:
            self.evaluate()
        if self.stop.requested:
            raise Stopped

    def _on_rollout_end(self) -> None:
        kept: list[list[Any]] = [self.progress.speeds, self.progress.failed, *self.progress.recent.values()]
        for values in kept:
            del values[:-RECENT]
        if self.progress.speeds:
            self._record_episodes()
        # SB3 writes a line at the end of an episode, and all episodes end at the same time.
        made = self.num_timesteps - self.training_env.num_envs
        if isinstance(self.model, OffPolicyAlgorithm) and made // LOG_EVERY < self.num_timesteps // LOG_EVERY:
            self.model.dump_logs()

    def _record_episodes(self) -> None:
        """Records the last episodes in the log and on the progress bar."""
        speed, failed = float(np.mean(self.progress.speeds)), float(np.mean(self.progress.failed))
        self.logger.record("episodes/mean_speed", speed)
        self.logger.record("episodes/over_baseline", speed / self.baseline_speed)
        self.logger.record("episodes/failed", failed)
        # Medians, since a single episode without progress has an infinite cost.
        medians = {
            name: float(np.median([math.inf if value is None else value for value in values]))
            for name, values in self.progress.recent.items()
        }
        for name, value in medians.items():
            if math.isfinite(value):
                self.logger.record(f"episodes/{name}", value)
        cost, stuck = medians.get("cost_of_transport", math.inf), medians.get("stuck_fraction", math.nan)
        self.bar.set_postfix_str(
            # A narrow terminal cuts the end.
            f"{speed:.2f} cm/s ({BASELINE} {self.baseline_speed:.2f}), failed {100.0 * failed:.0f} %, "
            f"cost of transport {cost:.2f}, stuck {100.0 * stuck:.0f} %",
            refresh=False,
        )

    def _on_training_end(self) -> None:
        self.evaluate()

    def policy(self) -> Policy | None:
        """The deterministic policy of the agent at present; None under wrappers."""
        kwargs, name = self.config.env_kwargs(), self.run.name
        if self.config.wrapper:
            return None
        if isinstance(self.model, RecurrentPPO):
            return present_policy(name, self.model, kwargs)
        return export(name, self.model, env_kwargs=kwargs, training_seed=self.config.seed, revision=self.revision)

    def evaluate(self) -> None:
        """Evaluates the deterministic policy; writes a line, a checkpoint, and the best model where it is one."""
        policy = self.policy()
        if policy is not None:
            episodes = evaluate(policy, self.plants)
        else:
            episodes = evaluate_wrapped(self.model, self.config, self.plants)
        speed = float(interquartile_mean(scores(episodes, "mean_speed"))[0])
        failed = float(scores(episodes, "failed").mean())
        power = float(scores(episodes, "energy").mean()) / HORIZON
        score = float(scores(episodes, "mean_speed").mean()) - self.config.energy_weight * power - FAILURE_COST * failed
        self.progress.evaluated_at = self.num_timesteps
        self.logger.record("evaluation/mean_speed", speed)
        self.logger.record("evaluation/failed", failed)
        self.logger.record("evaluation/score", score)
        cost = float(interquartile_mean(scores(episodes, "cost_of_transport"))[0])
        if math.isfinite(cost):
            self.logger.record("evaluation/cost_of_transport", cost)
        self.logger.record("evaluation/stuck_fraction", float(scores(episodes, "stuck_fraction").mean()))
        self.evaluations.add(
            {
                EVALUATED: self.num_timesteps,
                "seconds": f"{time.monotonic() - self.began:.1f}",
                "core_seconds": f"{time.process_time() - self.core_began:.1f}",
                "mean_speed_cm_s": f"{speed:.4f}",
                "failed": failed,
                "score_cm_s": f"{score:.4f}",
                "baseline_mean_speed_cm_s": f"{self.baseline_speed:.4f}",
            }
        )
        if self.progress.best_score is None or score > self.progress.best_score:
            self.progress.best_score = score
            save(self.run / BEST, self.model, policy)
        self.checkpoint()

    def checkpoint(self) -> None:
        """Writes a checkpoint, unless there is one at this step."""
        if self.latest is not None and self.latest.name == checkpoint.name_of(self.num_timesteps):
            return
        self.progress.elapsed = time.monotonic() - self.began
        self.progress.core_seconds = time.process_time() - self.core_began
        self.evaluations.synchronise()
        self.latest = checkpoint.write(
            self.run,
            self.num_timesteps,
            lambda folder: checkpoint.fill(folder, self.model, self.progress),
            before=self.latest,
        )


def evaluate_wrapped(model: BaseAlgorithm, config: Config, plants: EvaluationSet) -> list[Episode]:
    """One episode on every plant, from rest, in environments with the run's wrappers; as `evaluate` returns them."""
    normalised = model.get_vec_normalize_env()
    assert normalised is not None
    steps = round(HORIZON / config.env_kwargs().get("control_dt", CONTROL_DT))
    episodes = []
    for plant in plants.plants:
        env = wrapped_env(config.wrapper, {**config.env_kwargs(), **EPISODE_SETTINGS}, steps)
        state = np.array([plant.theta, 0.0, 0.0, 0.0])
        observation, _ = env.reset(seed=plant.seed, options={"M": plant.M, "mu": plant.mu, "state": state})
        memory, begins, ended = None, np.ones(1, np.bool_), False
        while not ended:
            action, memory = model.predict(
                normalised.normalize_obs(observation), state=memory, episode_start=begins, deterministic=True
            )
            observation, _, terminated, truncated, info = env.step(action)
            begins, ended = np.zeros(1, np.bool_), terminated or truncated
        env.close()
        # Of the last step.
        episodes.append({"M": plant.M, "mu": plant.mu, "seed": plant.seed, **info["metrics"]})
    return episodes
