"""Starts and resumes a run: its folder, its agent, and the call of Stable-Baselines3's `learn`."""

import dataclasses
import json
import pickle
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from agents.training import checkpoint
from agents.training.algorithms import CLASSES, make_env, make_model
from agents.training.callbacks import Stopped, TrainingCallback
from agents.training.checkpoint import LOCK, Progress, git_revision, locked
from agents.training.config import BEST, CONFIG, LOGS, MODEL, RIG, Config, RunError, read_config
from agents.training.export import save
from agents.training.signals import Stop
from capsule_gym.evaluation.episodes import versions
from capsule_gym.files import add_name_to_errors, canonical_hash, to_json, write_atomically


def begin(run: Path, config: Config) -> None:
    """Creates the folder of a new run, if the environments and the agent accept its configuration.

    Raises:
        FileExistsError: if the folder exists and is not empty; of two processes that begin a run
            there, for the second.
        OSError: if the folder cannot be created.
        RunError: if another process holds the folder's lock.
        TypeError, ValueError: if a field of the configuration has the wrong type or is out of
            range.
    """
    check_unused(run)
    config.check()
    _check_agent(config)
    env_kwargs = json.dumps(config.env_kwargs(), default=dataclasses.asdict)
    content = {
        "algo": config.algo,
        "task": config.action_mode,
        "seed": config.seed,
        "env": json.loads(env_kwargs),
        "hyperparameters": config.to_dict(),
        "versions": versions(),
        "revision": git_revision(),
    }
    run.mkdir(parents=True, exist_ok=True)
    with locked(run):
        # Another process may have begun a run here while the agent was created.
        check_unused(run)
        if config.rig is not None:
            write_atomically(run / RIG, Path(config.rig).read_bytes())
        write_atomically(run / CONFIG, to_json(content))


def _check_agent(config: Config) -> None:
    """Raises the errors of an agent before a run's folder is created.

    `train` creates the agent again and shows its warnings.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = make_env(config, config.seed)
        try:
            make_model(config, env)
        except Exception as error:
            raise RunError(f"these hyperparameters are invalid: {_reason(error)}") from error
        try:
            pickle.dumps(env.venv)
        except Exception as error:
            accepted = "picklable, for checkpoints"
            raise RunError(
                f"--wrapper must be {accepted}, got {config.wrapper}: {error}"
            ) from error
        finally:
            env.close()


def _reason(error: Exception) -> str:
    """The type of an error and the first line of its message."""
    message = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {message}"


def check_unused(run: Path) -> None:
    """Raises a FileExistsError for a folder that contains anything but a lock."""
    if run.exists() and any(path.name != LOCK for path in run.iterdir()):
        raise FileExistsError(f"{run} already exists")


def train(run: Path, total_steps: int | None = None, *, wandb: bool = False) -> bool:
    """Trains a run until its total_steps, Ctrl-C or SIGTERM.

    Resumes it from its last undamaged checkpoint, if any.

    Args:
        run: the run's folder, from `begin`.
        total_steps: new number of steps, which is written to config.json; None keeps the number.
        wandb: whether to also log to Weights & Biases.

    Returns:
        Whether the run is complete. If not, the folder holds a checkpoint of the current step.

    Raises:
        RunError: if another process trains the run, a file of the folder is broken, or Weights &
            Biases is not usable.
        OSError: if the folder cannot be written to; its files are unchanged.
    """
    with add_name_to_errors(run), locked(run):
        torch.set_num_threads(1)
        _remove_partial_files(run)
        latest = checkpoint.newest_whole(run)
        least = 1 if latest is None else checkpoint.steps_of(latest)
        config, revision = _read(run, total_steps, least)
        if latest is None and (run / MODEL).exists():
            raise RunError(f"{run} has a trained agent, {MODEL}, but no checkpoint to resume from")
        model, progress, restore_streams = _load(run, config, latest)
        stop = Stop()
        callback = TrainingCallback(run, config, progress, latest, restore_streams, stop, revision)
        online = start_wandb(run, config) if wandb else None
        _log_to(run / LOGS, model)
        try:
            with stop:
                _learn(model, config, callback)
        except Stopped:
            callback.checkpoint()
        except ValueError as error:
            if all(weights.isfinite().all() for weights in model.policy.parameters()):
                raise
            diverged = f"the training of {run} diverged, its weights are not finite"
            causes = "learning_rate is too large, or a wrapper's reward is not finite"
            raise RunError(f"{diverged}: {causes}") from error
        finally:
            callback.bar.close()
            model.logger.close()
            if online:
                online.finish()
            model.get_env().close()  # type: ignore[union-attr]  # it has one
        callback.model = model
        save(run, model, callback.policy())
        return not stop.requested


def _remove_partial_files(run: Path) -> None:
    """Removes the temporary files of a process that was killed while writing.

    Only the holder of the lock writes files of these names.
    """
    for folder in (run, run / BEST):
        for name in checkpoint.WRITTEN:
            for file in folder.glob(f".{name}.*.tmp*"):
                file.unlink()


def _load(
    run: Path, config: Config, latest: Path | None
) -> tuple[BaseAlgorithm, Progress, Callable[[], None]]:
    """Creates the agent of a run, or reads it from its last checkpoint.

    Returns:
        As `checkpoint.restore`.

    Raises:
        RunError: if the agent cannot be created, or the settings differ from the checkpoint's.
    """
    settings = config.to_dict()
    # The only setting that may change.
    del settings["total_steps"]
    try:
        env = make_env(config, config.seed)
        if latest is None:
            return make_model(config, env), Progress(settings), lambda: None
        model, progress, restore_streams = checkpoint.restore(latest, CLASSES[config.algo], env)
    except RunError:
        raise
    except Exception as error:
        raise RunError(f"{run / CONFIG} is invalid: {_reason(error)}") from error
    for name, value in progress.settings.items():
        if settings[name] != value:
            accepted = f"{value!r} as in {latest.name}"
            raise RunError(f"{run / CONFIG}: {name} must stay {accepted}, got {settings[name]!r}")
    return model, progress, restore_streams


def _log_to(folder: Path, model: BaseAlgorithm) -> None:
    """Sets the log of an agent: a table and a file of TensorBoard."""
    # SB3's writer overwrites its file, so that every process writes its own file, named by its
    # first step.
    table = make_output_format("csv", str(folder), f"-{model.num_timesteps:012d}")
    tensorboard = make_output_format("tensorboard", str(folder))
    model.set_logger(Logger(str(folder), [table, tensorboard]))


def _learn(model: BaseAlgorithm, config: Config, callback: TrainingCallback) -> None:
    """Trains an agent until the run's total_steps."""
    remaining = config.total_steps - model.num_timesteps
    if remaining > 0:
        # SB3 logs every rollout of on-policy algorithms; the callback logs off-policy algorithms.
        interval: Any = None if isinstance(model, OffPolicyAlgorithm) else 1
        model.learn(
            remaining,
            callback=callback,
            log_interval=interval,
            reset_num_timesteps=False,
        )


def start_wandb(run: Path, config: Config) -> Any:
    """Starts a run of Weights & Biases, which follows TensorBoard's log.

    Raises:
        RunError: if wandb does not start.
    """
    import wandb

    # The same folder with the same settings resumes the same run.
    settings = {**config.to_dict(), "total_steps": None}
    identity = canonical_hash([str(run.resolve()), settings])[:16]
    try:
        return wandb.init(
            project="capsule_gym",
            name=run.name,
            id=identity,
            config=config.to_dict(),
            dir=run,
            resume="allow",
            sync_tensorboard=True,
        )
    except wandb.errors.Error as error:
        raise RunError(f"--wandb: {error}") from error


def _read(run: Path, total_steps: int | None, least: int) -> tuple[Config, str]:
    """Reads the configuration of a run and the git revision of its start.

    Prints what has changed since.

    Raises:
        RunError: if config.json cannot be read, or `total_steps` differs from it and is below
            `least`.
    """
    config = read_config(run)
    content = json.loads((run / CONFIG).read_text(encoding="utf-8"))
    changed = total_steps is not None and total_steps != config.total_steps
    if total_steps is not None and changed:
        if total_steps < least:
            accepted = f"an integer >= {least}, the steps of the run"
            raise RunError(f"total_steps must be {accepted}, got {total_steps}")
        config = dataclasses.replace(config, total_steps=total_steps)
    present = versions()
    for name, number in content.get("versions", {}).items():
        now = present.get(name, number)
        if number != now:
            change = f"{name} {number} is now {now}"
            print(f"warning: not the same run to the last bit, since {change}", file=sys.stderr)
    if changed:
        end = f"{config.total_steps:,} steps"
        print(f"The learning rate now falls until {end}: this is another run than before.")
        content["hyperparameters"]["total_steps"] = config.total_steps
        write_atomically(run / CONFIG, to_json(content))
    return config, str(content.get("revision") or "unknown")
