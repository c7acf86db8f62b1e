"""Starts and resumes a run: its folder, its agent, and the call of Stable-Baselines3's `learn`."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import shutil
import sys
import warnings
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from agents.evaluation.episodes import versions
from agents.training import checkpoint
from agents.training.algorithms import LinearSchedule, algorithm, make_env, make_model
from agents.training.callbacks import Stopped, TrainingCallback, make_logger, quiet_tensorboard
from agents.training.checkpoint import Progress, git_revision, locked
from agents.training.export import save
from agents.training.presets import CONFIG, Config, RunError, read_config
from agents.training.signals import Stop
from capsule_gym.files import naming, to_json, write_atomically


def begin(run: Path, config: Config) -> None:
    """Makes the folder of a new run, after the environments and the agent have accepted its configuration.

    Raises:
        FileExistsError: if it exists.
        OSError: if it cannot be made.
        TypeError: if a field of the configuration is of the wrong type.
        ValueError: if a field of the configuration is out of range.
    """
    if run.exists():
        raise FileExistsError(f"{run} exists already")
    _check_agent(config)
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
    # Atomically: a folder without its configuration could be neither started nor resumed.
    partial = run.with_name(f".{run.name}.{os.getpid()}.partial")
    partial.mkdir()
    try:
        write_atomically(partial / CONFIG, to_json(content))
        partial.rename(run)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _check_agent(config: Config) -> None:
    """Makes the environments and the agent of a configuration, for the errors that they raise."""
    config.check()
    # Warnings are shown when they are made again.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = make_env(config, config.seed)
        try:
            make_model(config, env)
        except Exception as error:
            reason = str(error).partition("\n")[0]
            raise RunError(f"these hyperparameters give no agent: {type(error).__name__}: {reason}") from error
        try:
            pickle.dumps(env.venv)
        except Exception as error:
            raise RunError(f"--wrapper must be picklable, for checkpoints, got {config.wrapper}: {error}") from error
        finally:
            env.close()


def train(run: Path, config: Config, *, wandb: bool = False) -> bool:
    """Trains a run, or resumes it from its last whole checkpoint, until config.total_steps, Ctrl-C or SIGTERM.

    Args:
        run: the run's folder, as `begin` made it.
        config: its configuration; only total_steps may differ.
        wandb: whether it is also logged to Weights & Biases.

    Returns:
        Whether it is complete. If not, the folder holds a checkpoint of the present step.

    Raises:
        RunError: if another process trains it, a file of the folder is broken, or Weights & Biases cannot be used.
        OSError: if the folder cannot be written to; its files stay as they were.
    """
    torch.set_num_threads(config.torch_threads)
    with naming(run), locked(run), quiet_tensorboard():
        revision = note_changes(run, config)
        checkpoint.clean_up(run)
        latest = checkpoint.newest_whole(run)
        checkpoint.restore_best(latest, run)
        progress = Progress(config.total_steps) if latest is None else Progress.read(latest)
        stop = Stop()
        callback = TrainingCallback(run, config, progress, latest, stop, revision)
        env = make_env(config, config.seed)
        if latest is None:
            model, set_streams = make_model(config, env), None
        else:
            model, set_streams = checkpoint.restore(latest, algorithm(config), env)
            progress.resumed_at.append(model.num_timesteps)
            # The schedule has another end where total_steps has changed.
            model.learning_rate = LinearSchedule(config.learning_rate, config.final_learning_rate)
            model._setup_lr_schedule()
        model.set_logger(make_logger(run, config, model.num_timesteps, wandb))
        try:
            with stop:
                if set_streams is not None:
                    set_streams()
                remaining = config.total_steps - model.num_timesteps
                if remaining > 0:
                    # SB3 writes a line per rollout, or none.
                    interval: Any = None if isinstance(model, OffPolicyAlgorithm) else 1
                    fresh = model.num_timesteps == 0
                    model.learn(remaining, callback=callback, log_interval=interval, reset_num_timesteps=fresh)
        except Stopped:
            callback.checkpoint()
        finally:
            callback.bar.close()
            model.logger.close()
            model.get_env().close()  # type: ignore[union-attr]
        callback.model = model
        save(run, model, callback.policy())
        return not stop.requested


def note_changes(run: Path, config: Config) -> str:
    """Prints how a resumed run differs from the one that was started, and writes a changed total_steps to its file.

    Returns:
        The git revision that it was started at.

    Raises:
        RunError: if config.json cannot be read, or is another run's.
    """
    path = run / CONFIG
    begun = read_config(run)
    if dataclasses.replace(begun, total_steps=config.total_steps) != config:
        raise RunError(f"{path} must hold the configuration of the run; only total_steps may change")
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
