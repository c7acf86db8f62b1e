"""Trains a Stable-Baselines3 agent: the loop, its progress, its evaluations and its checkpoints."""

from __future__ import annotations

import csv
import json
import sys
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.utils import LinearSchedule, set_random_seed
from stable_baselines3.common.vec_env import VecNormalize
from tqdm import tqdm

from agents.evaluation.candidates import BASELINE
from agents.evaluation.episodes import evaluate, scores, versions
from agents.evaluation.sets import EvaluationSet, PlantSpec
from agents.evaluation.statistics import interquartile_mean
from agents.training.presets import CONFIG, MODEL, NORMALISATION, Config, PPOConfig, SACConfig
from agents.training.runs import (
    ALGORITHMS,
    PROGRESS,
    REPLAY_BUFFER,
    Normalisation,
    TrainedPolicy,
    git_revision,
    latest_checkpoint,
    save_checkpoint,
    save_model,
)
from agents.training.sac import LeanSAC
from agents.training.vec_env import CapsuleSB3VecEnv
from baselines.policies import SCRIPTED
from capsule_gym import Capsule, Randomization
from capsule_gym.files import to_json, write_atomically
from capsule_gym.simulation import Stream, random_stream

# Far from the seeds 0, 1, .. that training runs and evaluation sets use: model selection sees draws of its own.
SELECTION_SEED = 1_000_000
# Episodes that the progress bar's mean speed is over.
RECENT = 128


def own_draws(config: Config) -> EvaluationSet:
    """The plants that a run selects its best model on: its own randomisation, seeds that nothing else uses."""
    randomization = Randomization.named(config.randomization)
    first = SELECTION_SEED + config.seed * config.evaluation_episodes
    plants = []
    for seed in range(first, first + config.evaluation_episodes):
        M, mu = randomization.draw(random_stream(seed, 0, Stream.parameters), Capsule())
        plants.append(PlantSpec(M=M, mu=mu, seed=seed))
    return EvaluationSet(f"own draws from {config.randomization}", tuple(plants))


def make_env(config: Config, seed: int) -> VecNormalize:
    """The training environments with their observations normalised."""
    batch = CapsuleSB3VecEnv(config.num_envs, seed=seed, threads=config.env_threads, **config.env_kwargs())
    return VecNormalize(batch, norm_obs=True, norm_reward=False, gamma=config.gamma)


def make_model(config: Config, env: VecNormalize, sac: type[SAC] = LeanSAC, fused: bool = True) -> BaseAlgorithm:
    """A fresh agent.

    Args:
        config: its hyperparameters.
        env: what it trains in.
        sac: the class that SAC is made of.
        fused: whether SAC's steps of Adam are one call each; PPO's minibatches are too large to notice.
    """
    network: dict[str, Any] = {"net_arch": [config.hidden, config.hidden]}
    shared: dict[str, Any] = {
        "learning_rate": LinearSchedule(config.learning_rate, config.final_learning_rate, 1.0),
        "batch_size": config.batch_size,
        "gamma": config.gamma,
        "seed": config.seed,
        "device": "cpu",
    }
    if isinstance(config, PPOConfig):
        return PPO(
            "MlpPolicy",
            env,
            n_steps=config.n_steps,
            n_epochs=config.n_epochs,
            gae_lambda=config.gae_lambda,
            ent_coef=config.ent_coef,
            policy_kwargs={**network, "log_std_init": config.log_std_init},
            **shared,
        )
    assert isinstance(config, SACConfig)
    return sac(
        "MlpPolicy",
        env,
        buffer_size=config.buffer_size,
        learning_starts=config.learning_starts,
        train_freq=1,
        gradient_steps=config.gradient_steps,
        tau=config.tau,
        policy_kwargs={**network, "optimizer_kwargs": {"fused": fused}},
        **shared,
    )


@dataclass
class Progress:
    """What a run has come to; saved with every checkpoint."""

    elapsed: float = 0.0
    best_speed: float | None = None
    resumed_at: list[int] = field(default_factory=list)


class Monitor(BaseCallback):
    """Progress bar, logs, evaluations on draws of the run's own, checkpoints and the best model.

    Args:
        run: the run's folder.
        config: the run's configuration.
        progress: where it stands.
        baseline_speed: mean speed of the paper's controller on the run's own draws, cm/s.
        draws: those draws.
    """

    def __init__(
        self, run: Path, config: Config, progress: Progress, baseline_speed: float, draws: EvaluationSet
    ) -> None:
        super().__init__()
        self.run = run
        self.config = config
        self.progress = progress
        self.baseline_speed = baseline_speed
        self.draws = draws
        self.speeds: deque[float] = deque(maxlen=RECENT)
        self.failed: deque[float] = deque(maxlen=RECENT)
        self.evaluated_at = 0

    def _on_training_start(self) -> None:
        self.evaluated_at = self.num_timesteps
        self.began = time.monotonic() - self.progress.elapsed
        self.bar = tqdm(
            total=self.config.total_steps,
            initial=self.num_timesteps,
            unit=" steps",
            unit_scale=True,
            smoothing=0.05,
            mininterval=0.5 if sys.stderr.isatty() else 10.0,
            dynamic_ncols=True,
        )

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "metrics" in info:
                self.speeds.append(info["metrics"]["mean_speed"])
                self.failed.append(info["metrics"]["failed"])
        self.bar.update(self.num_timesteps - self.bar.n)
        return True

    def _on_rollout_start(self) -> None:
        # Between updates, so that a checkpoint holds a consistent model.
        if self.num_timesteps - self.evaluated_at >= self.config.evaluate_every:
            self.evaluate()

    def _on_rollout_end(self) -> None:
        if not self.speeds:
            return
        speed, failed = float(np.mean(self.speeds)), float(np.mean(self.failed))
        self.logger.record("episodes/mean_speed", speed)
        self.logger.record("episodes/over_baseline", speed / self.baseline_speed)
        self.logger.record("episodes/failed", failed)
        self.bar.set_postfix_str(
            f"{speed:.2f} cm/s ({BASELINE} {self.baseline_speed:.2f}), {100.0 * failed:.0f} % failed", refresh=False
        )

    def _on_training_end(self) -> None:
        self.evaluate()
        self.bar.close()

    def evaluate(self) -> None:
        """Evaluates the deterministic policy, writes a line, a checkpoint, and the best model where it is one."""
        policy = self.policy()
        episodes = evaluate(policy, self.draws)
        speed = float(interquartile_mean(scores(episodes, "mean_speed"))[0])
        failed = float(scores(episodes, "failed").mean())
        self.evaluated_at = self.num_timesteps
        self.logger.record("evaluation/mean_speed", speed)
        self.logger.record("evaluation/failed", failed)
        self.progress.elapsed = time.monotonic() - self.began
        path = self.run / "evaluations.csv"
        fresh = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["steps", "seconds", "mean_speed_cm_s", "failed", "baseline_mean_speed_cm_s"])
            writer.writerow(
                [
                    self.num_timesteps,
                    f"{self.progress.elapsed:.1f}",
                    f"{speed:.4f}",
                    failed,
                    f"{self.baseline_speed:.4f}",
                ]
            )
        if self.progress.best_speed is None or speed > self.progress.best_speed:
            self.progress.best_speed = speed
            save_model(self.run / "best", self.model, policy.normalisation)
        self.checkpoint()

    def checkpoint(self) -> None:
        """Writes what --resume needs."""
        self.progress.elapsed = time.monotonic() - self.began
        save_checkpoint(self.run, self.model, self.policy().normalisation, vars(self.progress))

    def policy(self) -> TrainedPolicy:
        """The policy as it is now."""
        env = self.model.get_vec_normalize_env()
        assert env is not None
        return TrainedPolicy(self.run.name, self.config.env_kwargs(), self.model, Normalisation.of(env))


def begin(run: Path, config: Config) -> None:
    """Makes the folder of a new run.

    Raises:
        FileExistsError: if it exists.
    """
    run.mkdir(parents=True)
    content = {
        "algo": config.algo,
        "task": config.task,
        "seed": config.seed,
        "env": config.env_kwargs(),
        "hyperparameters": config.to_dict(),
        "versions": versions(),
        "revision": git_revision(Path(__file__).parent),
    }
    write_atomically(run / CONFIG, to_json(content))


def train(run: Path, config: Config) -> bool:
    """Trains, or goes on training, until config.total_steps or Ctrl-C.

    Args:
        run: the run's folder, as `begin` made it.
        config: its configuration.

    Returns:
        Whether it came to the end. After Ctrl-C the folder holds a checkpoint of that moment.
    """
    torch.set_num_threads(config.torch_threads)
    set_random_seed(config.seed)
    checkpoint = latest_checkpoint(run)
    progress = Progress()
    # A resumed run must not meet the first episodes of its seed again.
    env_seed = config.seed * 1000
    if checkpoint is not None:
        progress = Progress(**json.loads((checkpoint / PROGRESS).read_text(encoding="utf-8")))
        env_seed += 100_000 * (1 + len(progress.resumed_at))
    env = make_env(config, env_seed)
    if checkpoint is None:
        model = make_model(config, env)
    else:
        Normalisation.read(checkpoint / NORMALISATION).apply_to(env)
        model = ALGORITHMS[config.algo].load(checkpoint / MODEL, env=env, device="cpu")
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(checkpoint / REPLAY_BUFFER)
        set_random_seed(config.seed + model.num_timesteps)
        progress.resumed_at.append(model.num_timesteps)
    suffix = f"-from-{model.num_timesteps}" if checkpoint is not None else ""
    folder = str(run / "logs")
    model.set_logger(Logger(folder, [make_output_format(kind, folder, suffix) for kind in ("csv", "tensorboard")]))

    draws = own_draws(config)
    baseline = evaluate(SCRIPTED[BASELINE], draws)
    monitor = Monitor(run, config, progress, float(interquartile_mean(scores(baseline, "mean_speed"))[0]), draws)
    try:
        remaining = config.total_steps - model.num_timesteps
        if remaining > 0:
            model.learn(remaining, callback=monitor, reset_num_timesteps=checkpoint is None)
    except KeyboardInterrupt:
        monitor.bar.close()
        monitor.checkpoint()
        save_model(run, model, monitor.policy().normalisation)
        return False
    finally:
        model.logger.close()
        env.close()
    save_model(run, model, Normalisation.of(env))
    return True
