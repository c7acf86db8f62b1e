"""Starts and resumes a run: its folder, its agent, and the call of Stable-Baselines3's `learn`."""

import dataclasses
import json
import pickle
import sys
import warnings
from itertools import product
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from agents.training import checkpoint
from agents.training.algorithms import CLASSES, make_env, make_model, schedule
from agents.training.callbacks import Stopped, TrainingCallback
from agents.training.checkpoint import LOCK, Progress, git_revision, locked
from agents.training.config import BEST, CONFIG, LOGS, MODEL, Config, RunError, read_config
from agents.training.export import save
from agents.training.signals import Stop
from capsule_gym.evaluation.episodes import versions
from capsule_gym.files import add_name_to_errors, canonical_hash, to_json, write_atomically


def begin(run: Path, config: Config) -> None:
    """Creates the folder of a new run, after the environments and the agent have accepted its
    configuration.

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
    # Raises an agent's errors before the folder is created. `train` creates the agent again and
    # shows its warnings.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = make_env(config, config.seed)
        try:
            make_model(config, env)
        except Exception as error:
            reason = str(error).partition("\n")[0]
            raise RunError(
                f"these hyperparameters are invalid: {type(error).__name__}: {reason}"
            ) from error
        try:
            pickle.dumps(env.venv)
        except Exception as error:
            raise RunError(
                f"--wrapper must be picklable, for checkpoints, got {config.wrapper}: {error}"
            ) from error
        finally:
            env.close()
    content = {
        "algo": config.algo,
        "task": config.action_mode,
        "seed": config.seed,
        "env": json.loads(json.dumps(config.env_kwargs(), default=dataclasses.asdict)),
        "hyperparameters": config.to_dict(),
        "versions": versions(),
        "revision": git_revision(Path(__file__).parent),
    }
    run.mkdir(parents=True, exist_ok=True)
    with locked(run):
        # Another process may have begun a run here while the agent was created.
        check_unused(run)
        write_atomically(run / CONFIG, to_json(content))


def check_unused(run: Path) -> None:
    """Raises a FileExistsError for a folder that contains anything but a lock."""
    if run.exists() and any(path.name != LOCK for path in run.iterdir()):
        raise FileExistsError(f"{run} already exists")


def train(run: Path, total_steps: int | None = None, *, wandb: bool = False) -> bool:
    """Trains a run, or resumes it from its last undamaged checkpoint, until its total_steps, Ctrl-C
    or SIGTERM.

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
        # Left by a process that was killed while writing; only the holder of the lock writes files
        # of these names.
        for folder, name in product((run, run / BEST), checkpoint.WRITTEN):
            for file in folder.glob(f".{name}.*.tmp*"):
                file.unlink()
        latest = checkpoint.newest_whole(run)
        config, revision = _read(
            run, total_steps, 1 if latest is None else checkpoint.steps_of(latest)
        )
        if latest is None and (run / MODEL).exists():
            raise RunError(f"{run} has a trained agent, {MODEL}, but no checkpoint to resume from")
        settings = {
            name: value for name, value in config.to_dict().items() if name != "total_steps"
        }
        try:
            env = make_env(config, config.seed)
            if latest is None:
                model, progress, restore_streams = (
                    make_model(config, env),
                    Progress(settings),
                    lambda: None,
                )
            else:
                model, progress, restore_streams = checkpoint.restore(
                    latest, CLASSES[config.algo], env
                )
        except RunError:
            raise
        except Exception as error:
            reason = str(error).partition("\n")[0]
            raise RunError(
                f"{run / CONFIG} is invalid: {type(error).__name__}: {reason}"
            ) from error
        if latest is not None:
            for name, value in progress.settings.items():
                if settings[name] != value:
                    was = f"{value!r} as in {latest.name}"
                    raise RunError(
                        f"{run / CONFIG}: {name} must stay {was}, got {settings[name]!r}"
                    )
            # The end of the schedule differs if total_steps has changed.
            model.learning_rate = schedule(config)
            model._setup_lr_schedule()
        stop = Stop()
        callback = TrainingCallback(run, config, progress, latest, restore_streams, stop, revision)
        online = start_wandb(run, config) if wandb else None
        (run / LOGS).mkdir(exist_ok=True)
        # SB3's writer overwrites its file, so that every process writes its own file, named by its
        # first step.
        table = make_output_format("csv", str(run / LOGS), f"-{model.num_timesteps:012d}")
        model.set_logger(
            Logger(str(run / LOGS), [table, make_output_format("tensorboard", str(run / LOGS))])
        )
        try:
            with stop:
                remaining = config.total_steps - model.num_timesteps
                if remaining > 0:
                    # SB3 logs every rollout of on-policy algorithms; the callback logs off-policy
                    # algorithms.
                    interval: Any = None if isinstance(model, OffPolicyAlgorithm) else 1
                    fresh = model.num_timesteps == 0
                    model.learn(
                        remaining,
                        callback=callback,
                        log_interval=interval,
                        reset_num_timesteps=fresh,
                    )
        except Stopped:
            callback.checkpoint()
        except ValueError as error:
            if all(weights.isfinite().all() for weights in model.policy.parameters()):
                raise
            causes = "learning_rate is too large, or a wrapper's reward is not finite"
            raise RunError(
                f"the training of {run} diverged, its weights are not finite: {causes}"
            ) from error
        finally:
            callback.bar.close()
            model.logger.close()
            if online:
                online.finish()
            model.get_env().close()  # type: ignore[union-attr]  # it has one
        callback.model = model
        save(run, model, callback.policy())
        return not stop.requested


def start_wandb(run: Path, config: Config) -> Any:
    """Starts a run of Weights & Biases, which follows TensorBoard's log.

    Raises:
        RunError: if wandb does not start.
    """
    import wandb

    # The same folder with the same settings resumes the same run.
    identity = canonical_hash([str(run.resolve()), {**config.to_dict(), "total_steps": None}])[:16]
    options: dict[str, Any] = {
        "project": "capsule_gym",
        "resume": "allow",
        "sync_tensorboard": True,
    }
    try:
        return wandb.init(name=run.name, id=identity, config=config.to_dict(), dir=run, **options)
    except wandb.errors.Error as error:
        raise RunError(f"--wandb: {error}") from error


def _read(run: Path, total_steps: int | None, least: int) -> tuple[Config, str]:
    """Reads the configuration of a run and the git revision of its start; prints what has changed
    since.

    Raises:
        RunError: if config.json cannot be read, or `total_steps` differs from it and is below
            `least`.
    """
    begun = read_config(run)
    config = begun if total_steps is None else dataclasses.replace(begun, total_steps=total_steps)
    if config != begun and config.total_steps < least:
        raise RunError(
            f"total_steps must be an integer >= {least}, the steps of the run, got {config.total_steps}"
        )
    content = json.loads((run / CONFIG).read_text(encoding="utf-8"))
    present = versions()
    for name, number in content.get("versions", {}).items():
        if number != (now := present.get(name, number)):
            print(
                f"warning: not the same run to the last bit, since {name} {number} is now {now}",
                file=sys.stderr,
            )
    if begun != config:
        print(
            f"The learning rate now falls until {config.total_steps:,} steps: this is another run than before."
        )
        content["hyperparameters"]["total_steps"] = config.total_steps
        write_atomically(run / CONFIG, to_json(content))
    return config, str(content.get("revision") or "unknown")
