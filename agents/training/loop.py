"""Trains a Stable-Baselines3 agent: the loop, its progress, its evaluations and its checkpoints."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn
from tqdm import tqdm

from agents.evaluation.episodes import evaluate, scores, versions
from agents.evaluation.policies import BASELINE, Policy
from agents.evaluation.sets import validation_set
from agents.evaluation.statistics import interquartile_mean
from agents.training import checkpoint
from agents.training.checkpoint import Progress
from agents.training.collection import RolloutVecEnv
from agents.training.errors import RunError
from agents.training.export import export
from agents.training.lock import locked
from agents.training.logs import Table, make_logger, told_once, watched
from agents.training.ppo import ActorCritic, CapsulePPO, FastTanh, transfer
from agents.training.presets import (
    BEST,
    CONFIG,
    EVALUATED,
    EVALUATIONS,
    Config,
    OffPolicyConfig,
    OnPolicyConfig,
    PPOConfig,
    RecurrentPPOConfig,
    TD3Config,
    TQCConfig,
    read_config,
)
from agents.training.recurrent import RecurrentActorCritic, present_policy
from agents.training.runs import git_revision, save
from agents.training.sac import LeanSAC
from agents.training.stopping import Stop
from baselines.policies import SCRIPTED
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import naming, to_json, write_atomically
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.task import CONTROL_DT, HORIZON

# Far from the seeds 0, 1, .. that training runs and evaluation sets use: model selection sees draws of its own.
SELECTION_SEED = 1_000_000
# What the best model is chosen by: its mean speed less what its power costs, and so many cm/s times the share of its
# episodes that fail.
FAILURE_COST = 30.0
# Agent steps between two lines of the log of what updates after every step; the other algorithms write one per rollout.
LOG_EVERY = 2_000
# Episodes that the progress bar's mean speed is over.
RECENT = 128


@dataclass(frozen=True)
class Falling:
    """A learning rate that falls linearly, as SB3 asks for one.

    Attributes:
        start: at the start of the stage.
        end: at the end of the run.
        share: of the run, that is left when the stage begins.
    """

    start: float
    end: float
    share: float

    def __call__(self, left: float) -> float:
        """The rate where that share of the run is left, which is below 0 where the last rollout goes beyond the end."""
        return self.end + (self.start - self.end) * max(0.0, min(1.0, left / self.share))


def falling(config: Config) -> Falling:
    """The learning rate of a stage."""
    # What is left of the run when a stage begins falls to 0 as the rate reaches its end.
    begun = sum(stage.total_steps for stage in config.stages()[:-1]) / config.total_steps
    return Falling(config.learning_rate, config.final_learning_rate, 1.0 - begun)


def own_draws(config: Config) -> EvaluationSet:
    """The plants that a run selects its best model on: its own randomisation, seeds that nothing else uses."""
    first = SELECTION_SEED + config.seed * config.evaluation_episodes
    name = f"own draws from {config.randomization}"
    return validation_set(config.randomization, name, first, config.evaluation_episodes)


def make_env(config: Config, seed: int) -> VecNormalize:
    """The training environments with their observations normalised."""
    shared = {"seed": seed, "threads": config.env_threads, **config.env_kwargs()}
    batch: CapsuleSB3VecEnv
    if isinstance(config, PPOConfig):
        batch = RolloutVecEnv(
            config.num_envs,
            episode_steps=max(1, round(config.episode_seconds / config.control_dt)),
            identifies=config.identifies,
            privileged=config.privileged_critic,
            energy_weights=config.energy_weights,
            jump=config.jump_rate * config.control_dt,
            outputs_torque=config.output == "torque",
            **shared,
        )
    else:
        batch = CapsuleSB3VecEnv(config.num_envs, **shared)
    return VecNormalize(batch, norm_obs=True, norm_reward=False, gamma=config.gamma)


def make_model(config: Config, env: VecNormalize, sac: type[SAC] = LeanSAC, fused: bool = True) -> BaseAlgorithm:
    """A fresh agent.

    Args:
        config: its hyperparameters.
        env: what it trains in.
        sac: the class that SAC is made of.
        fused: whether steps of Adam are one call each.
    """
    network: dict[str, Any] = {"net_arch": [config.hidden, config.hidden]}
    shared: dict[str, Any] = {
        "learning_rate": falling(config),
        "batch_size": config.batch_size,
        "gamma": config.gamma,
        "seed": config.seed,
        "device": "cpu",
    }
    if isinstance(config, OnPolicyConfig):
        network |= {"log_std_init": config.log_std_init, "optimizer_kwargs": {"eps": 1e-5, "fused": fused}}
        shared |= {
            "n_steps": config.n_steps,
            "n_epochs": config.n_epochs,
            "gae_lambda": config.gae_lambda,
            "ent_coef": config.ent_coef,
        }
    if isinstance(config, PPOConfig):
        venv: Any = env.venv
        model = CapsulePPO(
            ActorCritic,
            env,
            policy_kwargs={
                **network,
                "policy_inputs": venv.header.inputs,
                "least_log_std": config.least_log_std,
                "tanh_mean": config.tanh_mean,
                "activation_fn": {"tanh": FastTanh, "relu": nn.ReLU}[config.activation],
            },
            **shared,
        )
        model.critic_steps = config.critic_steps
        return model
    if isinstance(config, RecurrentPPOConfig):
        return RecurrentPPO(
            RecurrentActorCritic,
            env,
            policy_kwargs={
                **network,
                "lstm_hidden_size": config.hidden,
                "enable_critic_lstm": config.recurrent_critic,
                "activation_fn": FastTanh,
            },
            **shared,
        )
    assert isinstance(config, OffPolicyConfig)
    network["optimizer_kwargs"] = {"fused": fused}
    shared |= {
        "buffer_size": config.buffer_size,
        "learning_starts": config.learning_starts,
        "train_freq": 1,
        "gradient_steps": config.gradient_steps,
        "tau": config.tau,
    }
    if isinstance(config, TD3Config):
        return TD3(
            "MlpPolicy",
            env,
            action_noise=_exploration(config),
            policy_delay=config.policy_delay,
            target_policy_noise=config.target_policy_noise,
            target_noise_clip=config.target_noise_clip,
            policy_kwargs=network,
            **shared,
        )
    if isinstance(config, TQCConfig):
        return TQC(
            "MlpPolicy",
            env,
            top_quantiles_to_drop_per_net=config.dropped_quantiles,
            policy_kwargs={**network, "n_quantiles": config.quantiles},
            **shared,
        )
    return sac("MlpPolicy", env, policy_kwargs=network, **shared)


def _exploration(config: TD3Config) -> ActionNoise:
    """The noise on the actions of TD3 while it trains."""
    mean, deviation, time = np.zeros(1), config.action_noise, config.noise_time
    if time == 0.0:
        return NormalActionNoise(mean, np.full(1, deviation))
    # Its deviation once it has forgotten where it began.
    sigma = np.full(1, deviation * math.sqrt(2.0 / time))
    return OrnsteinUhlenbeckActionNoise(mean, sigma, theta=1.0 / time, dt=CONTROL_DT)


class Stopped(Exception):  # noqa: N818
    """The run is to end between two updates, because its user wants it to."""


class Bar(tqdm):
    """A progress bar on a terminal; elsewhere lines, which a file can hold."""

    @staticmethod
    def status_printer(file: Any) -> Callable[[str], None]:
        """What shows the text of the bar."""
        if file.isatty():
            return cast("Callable[[str], None]", tqdm.status_printer(file))
        return lambda text: print(text.rstrip(), file=file, flush=True)


class Monitor(BaseCallback):
    """Progress bar, logs, evaluations on draws of the run's own, checkpoints and the best model.

    Args:
        run: the run's folder.
        config: the run's configuration.
        progress: where it stands.
        latest: the checkpoint that it goes on from, None for none.
        stop: whether it is to end.
        revision: the git revision that the run was begun at.
    """

    def __init__(
        self, run: Path, config: Config, progress: Progress, latest: Path | None, stop: Stop, revision: str
    ) -> None:
        super().__init__()
        self.run = run
        self.config = config
        self.revision = revision
        self.progress = progress
        self.latest = latest
        self.stop = stop
        self.draws = own_draws(config)
        baseline = evaluate(SCRIPTED[BASELINE], self.draws)
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
        """The last rollout goes beyond the total, where a bar would lose its percentage."""
        return min(self.num_timesteps, self.config.total_steps)

    def _remember(self, metrics: dict[str, float], total: float) -> None:
        """Keeps what is shown of an episode that has ended; the terms of its reward are cm, as `total` is."""
        self.progress.speeds.append(metrics["mean_speed"])
        self.progress.failed.append(metrics["failed"])
        progress, failure = 100.0 * metrics["distance"], -self.config.termination_penalty * metrics["failed"]
        shown = {
            "cost_of_transport": metrics["cost_of_transport"],
            "stuck_fraction": metrics["stuck_fraction"],
            "reward_progress": progress,
            # What is left, since an agent may be told another energy weight in every episode.
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
        # SB3's own lines come with the ends of episodes, which are all at the same time.
        made = self.num_timesteps - self.training_env.num_envs
        if isinstance(self.model, OffPolicyAlgorithm) and made // LOG_EVERY < self.num_timesteps // LOG_EVERY:
            self.model.dump_logs()

    def _record_episodes(self) -> None:
        """Tells the log and the progress bar of the last episodes."""
        speed, failed = float(np.mean(self.progress.speeds)), float(np.mean(self.progress.failed))
        self.logger.record("episodes/mean_speed", speed)
        self.logger.record("episodes/over_baseline", speed / self.baseline_speed)
        self.logger.record("episodes/failed", failed)
        # Medians, since a single episode without progress has an infinite cost.
        middle = {
            name: float(np.median([math.inf if value is None else value for value in values]))
            for name, values in self.progress.recent.items()
        }
        for name, value in middle.items():
            if math.isfinite(value):
                self.logger.record(f"episodes/{name}", value)
        cost, stuck = middle.get("cost_of_transport", math.inf), middle.get("stuck_fraction", math.nan)
        self.bar.set_postfix_str(
            # A narrow terminal cuts the end.
            f"{speed:.2f} cm/s ({BASELINE} {self.baseline_speed:.2f}), failed {100.0 * failed:.0f} %, "
            f"cost of transport {cost:.2f}, stuck {100.0 * stuck:.0f} %",
            refresh=False,
        )

    def _on_training_end(self) -> None:
        self.evaluate()

    def evaluate(self) -> None:
        """Evaluates the deterministic policy, writes a line, a checkpoint, and the best model where it is one."""
        policy = policy_of(self.run, self.config, self.revision, self.model)
        episodes = evaluate(policy, self.draws)
        speed = float(interquartile_mean(scores(episodes, "mean_speed"))[0])
        failed = float(scores(episodes, "failed").mean())
        spent = float(scores(episodes, "energy").mean()) / HORIZON
        score = float(scores(episodes, "mean_speed").mean()) - self.config.energy_weight * spent - FAILURE_COST * failed
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
                "stage": self.progress.stage,
                "baseline_mean_speed_cm_s": f"{self.baseline_speed:.4f}",
            }
        )
        if self.progress.best_score is None or score > self.progress.best_score:
            self.progress.best_score = score
            save(self.run / BEST, self.model, policy)
        self.checkpoint()

    def checkpoint(self) -> None:
        """Writes what --resume needs, unless it is there already."""
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


def policy_of(run: Path, config: Config, revision: str, model: BaseAlgorithm) -> Policy:
    """The policy that an agent of a run acts by at present."""
    kwargs = config.env_kwargs()
    if isinstance(model, RecurrentPPO):
        return present_policy(run.name, model, kwargs)
    return export(run.name, model, env_kwargs=kwargs, training_seed=config.seed, revision=revision)


def begin(run: Path, config: Config) -> None:
    """Makes the folder of a new run, once the environments and the agent are known to accept its configuration.

    Raises:
        FileExistsError: if it exists.
        OSError: if it cannot be made.
        TypeError: if a field of the configuration is of the wrong type.
        ValueError: if a field of the configuration is out of range.
    """
    if run.exists():
        raise FileExistsError(f"{run} exists already")
    try_out(config)
    content = {
        "algo": config.algo,
        "task": config.task,
        "seed": config.seed,
        "env": config.env_kwargs(),
        "hyperparameters": config.to_dict(),
        "versions": versions(),
        "revision": git_revision(Path(__file__).parent),
    }
    run.parent.mkdir(parents=True, exist_ok=True)
    # Whole or absent: a folder without its configuration could be neither begun nor gone on with.
    partial = run.with_name(f".{run.name}.{os.getpid()}.partial")
    partial.mkdir()
    try:
        write_atomically(partial / CONFIG, to_json(content))
        partial.rename(run)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def try_out(config: Config) -> None:
    """Makes the environments and the agent of a configuration, for what they refuse."""
    config.check()
    # What they warn of comes when they are made to stay.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = make_env(config, config.seed)
        try:
            make_model(config, env)
        except Exception as error:
            reason = str(error).partition("\n")[0]
            raise RunError(f"these hyperparameters give no agent: {type(error).__name__}: {reason}") from error
        finally:
            env.close()


def train(run: Path, config: Config, *, wandb: bool = False) -> bool:
    """Trains, or goes on training from the last whole checkpoint, until config.total_steps, Ctrl-C or SIGTERM.

    Gone on with, a run is the same run: it ends with the same policy, bit for bit, as one that was not stopped.

    Args:
        run: the run's folder, as `begin` made it.
        config: its configuration, in which total_steps alone may be another now.
        wandb: whether it is also logged to Weights & Biases.

    Returns:
        Whether it came to the end. Where it did not, the folder holds a checkpoint of that moment.

    Raises:
        RunError: if another process trains it, a file of the folder is broken, or Weights & Biases cannot be had.
        OSError: if the folder cannot be written to; what it held is still there.
    """
    torch.set_num_threads(config.torch_threads)
    with naming(run), locked(run), told_once(), watched(run, config.to_dict(), wandb) as writers:
        revision = note_changes(run, config)
        checkpoint.clean_up(run)
        latest = checkpoint.newest_whole(run)
        checkpoint.restore_best(latest, run)
        progress = Progress(config.total_steps) if latest is None else Progress.read(latest)
        stop = Stop()
        monitor = Monitor(run, config, progress, latest, stop, revision)
        stages = config.stages()
        model: BaseAlgorithm | None = None
        with stop:
            while True:
                model, done = _train_stage(run, stages, monitor, model, writers)
                if not done or progress.stage == len(stages) - 1:
                    break
                # The checkpoint of this moment stays the last stage's: who goes on from it comes here again.
                progress.stage, progress.best_score = progress.stage + 1, None
        save(run, model, policy_of(run, stages[progress.stage], revision, model))
        return not stop.requested


def _train_stage(
    run: Path,
    stages: Sequence[Config],
    monitor: Monitor,
    before: BaseAlgorithm | None,
    writers: Sequence[KVWriter],
) -> tuple[BaseAlgorithm, bool]:
    """Trains the stage that a run has come to, from its checkpoint or from the agent of the stage before.

    Returns:
        The agent, and whether the stage is complete.
    """
    progress, latest = monitor.progress, monitor.latest
    config = stages[progress.stage]
    env = make_env(config, config.seed)
    if before is None and latest is not None:
        model, set_streams = checkpoint.restore(latest, config.algo, env)
        progress.resumed_at.append(model.num_timesteps)
        # Where total_steps is another now, so is the schedule.
        model.learning_rate = falling(config)
        model._setup_lr_schedule()
    else:
        model = make_model(config, env)
        if before is not None:
            transfer(before, model)
    monitor.config = config
    model.set_logger(make_logger(run, model.num_timesteps, writers))
    # A stage's total_steps are the run's by its end.
    remaining = config.total_steps - model.num_timesteps
    try:
        if before is None and latest is not None:
            set_streams()
        # A stage before may have taken all steps, since it ends with a whole rollout: there is still this to evaluate.
        if remaining > 0 or before is not None:
            # As SB3 names its own lines: one per rollout, or none.
            interval: Any = None if isinstance(model, OffPolicyAlgorithm) else 1
            fresh = model.num_timesteps == 0
            model.learn(max(0, remaining), callback=monitor, log_interval=interval, reset_num_timesteps=fresh)
    except Stopped:
        monitor.checkpoint()
        return model, False
    finally:
        monitor.bar.close()
        model.logger.close()
        env.close()
    return model, True


def note_changes(run: Path, config: Config) -> str:
    """Says how a run that goes on differs from the one that was begun, and writes a new end down.

    Returns:
        The git revision that it was begun at.

    Raises:
        RunError: if config.json cannot be read, or is another run's.
    """
    path = run / CONFIG
    begun = read_config(run)
    if dataclasses.replace(begun, total_steps=config.total_steps) != config:
        raise RunError(f"{path} must hold the configuration that is trained, of which total_steps alone may change")
    content = json.loads(path.read_text(encoding="utf-8"))
    recorded = content.get("versions")
    present = versions()
    changed = [
        f"{name} {number} is now {present[name]}"
        for name, number in (recorded if isinstance(recorded, dict) else {}).items()
        if name in present and number != present[name]
    ]
    if changed:
        print(f"warning: not the same run to the last bit, since {', '.join(changed)}", file=sys.stderr)
    if begun.total_steps != config.total_steps:
        print(
            f"The learning rate was to fall until {begun.total_steps:,} steps and now does until "
            f"{config.total_steps:,}: this is another run than one with that end from its beginning."
        )
        content["hyperparameters"]["total_steps"] = config.total_steps
        write_atomically(path, to_json(content))
    revision = content.get("revision")
    return revision if isinstance(revision, str) and revision else "unknown"
