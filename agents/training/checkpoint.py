"""The folder of a training run, its lock and its checkpoints.

    config.json          algorithm, hyperparameters, environment, seed, package versions, git revision
    policy.safetensors   the last policy: `capsule_gym.load_policy`; not of an LSTM or under wrappers
    model.zip            the last agent, for Stable-Baselines3: `PPO.load`
    vecnormalize.pkl     the normalisation of its observations: `VecNormalize.load`
    best/                the same files for the best evaluation so far
    checkpoint-STEPS     everything that --resume needs, in one file that begins with its sha256; the last two
    evaluations.csv      the evaluations while training
    logs/                TensorBoard events, and progress-STEPS.csv of every process from its first step on
    lock                 held by the process that trains the run

A run that is resumed from a checkpoint ends with the same policy, bit for bit, as one that was not stopped. A
checkpoint is written atomically between two updates; only then the one before the last is deleted. Archives, .pkl
files and checkpoints contain pickles, which can run any code when loaded: resume only runs of your own. A policy file
contains none.
"""

from __future__ import annotations

import errno
import hashlib
import io
import pickle
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.config import RunError
from agents.training.export import archive, normalisation
from capsule_gym.files import synchronise, write_atomically

LOCK = "lock"
DIGEST_SIZE = hashlib.sha256().digest_size


@dataclass
class Progress:
    """The progress of a run."""

    settings: dict[str, Any]  # the hyperparameters of the run, but for its length
    core_seconds: float = 0.0  # processor seconds of training
    evaluations: list[dict[str, float]] = field(default_factory=list)  # the lines of evaluations.csv
    best_score: float = -np.inf  # of the best evaluation so far


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Locks a run's folder for this process. The system releases the lock when the process ends, however it ends.

    Raises:
        RunError: if another process holds the lock.
        OSError: if the folder cannot be written to.
    """
    lock = filelock.FileLock(run / LOCK, timeout=0)
    try:
        lock.acquire()
    except filelock.Timeout:
        raise RunError(f"{run} is being trained by another process") from None
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):
            raise
        print(f"{run}: this file system has no locks; make sure that no second process trains it", file=sys.stderr)
    try:
        yield
    finally:
        lock.release()


def git_revision(folder: Path) -> str:
    """The short git revision of a checkout, with "+" for uncommitted changes; "unknown" outside a checkout."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def path_of(run: Path, steps: int) -> Path:
    """The checkpoint at that many agent steps; the order of names is the order of steps."""
    return run / f"checkpoint-{steps:012d}"


def newest_whole(run: Path) -> Path | None:
    """The newest undamaged checkpoint of a run; damaged ones are named on stderr.

    Raises:
        RunError: if there are checkpoints, but all of them are damaged.
    """
    paths = sorted(run.glob("checkpoint-*"), reverse=True)
    for path in paths:
        if is_whole(path):
            return path
        print(f"warning: {path} is damaged; trying the one before", file=sys.stderr)
    if paths:
        raise RunError(f"{run} has no undamaged checkpoint: {', '.join(map(str, paths))}")
    return None


def is_whole(checkpoint: Path) -> bool:
    """Whether a checkpoint is what was written."""
    content = memoryview(checkpoint.read_bytes())
    return hashlib.sha256(content[DIGEST_SIZE:]).digest() == content[:DIGEST_SIZE]


def write(run: Path, model: BaseAlgorithm, progress: Progress, before: Path | None) -> Path:
    """Writes the state of a run between two updates; deletes all older ones but the one before it. Returns its path.

    Raises:
        OSError: if it cannot be written; the older ones stay as they were.
    """
    env, log = normalisation(model), model.logger
    content = pickle.dumps(
        {
            "model": archive(model),
            "progress": progress,
            "replay_buffer": model.replay_buffer if isinstance(model, OffPolicyAlgorithm) else None,
            # VecNormalize pickles itself without what it normalises.
            "normalize": env,
            "venv": env.venv,
            "torch": torch.get_rng_state(),
            "numpy": np.random.get_state(),
            "python": random.getstate(),
            "actions": model.action_space.np_random.bit_generator.state,
            # SB3 resets it when the training goes on.
            "action_noise": getattr(model, "action_noise", None),
            # Of RecurrentPPO, whose loading clears it.
            "lstm_states": getattr(model, "_last_lstm_states", None),
            # Values that the log has not written yet.
            "log": (dict(log.name_to_value), dict(log.name_to_count), dict(log.name_to_excluded)),
        }
    )
    path = path_of(run, model.num_timesteps)
    write_atomically(path, hashlib.sha256(content).digest() + content)
    synchronise(run)
    for other in run.glob("checkpoint-*"):
        if other not in (path, before):
            other.unlink()
    return path


def restore(
    checkpoint: Path, kind: type[BaseAlgorithm], env: VecNormalize
) -> tuple[BaseAlgorithm, Progress, Callable[[], None]]:
    """The agent of a whole checkpoint of the user's own, which is unpickled; its environments replace `env`.

    Returns:
        The agent, how far it is, and a function that restores the random streams and the log: to be called when the
        agent begins to learn.

    Raises:
        RunError: if it cannot be understood, for example because other versions wrote it.
    """
    try:
        state: dict[str, Any] = pickle.loads(checkpoint.read_bytes()[DIGEST_SIZE:])
        # Making the model seeds its environments: it gets the others afterwards.
        model = kind.load(io.BytesIO(state["model"]), env=env, device="cpu", force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            model.replay_buffer = state["replay_buffer"]
        if state["lstm_states"] is not None:
            vars(model)["_last_lstm_states"] = state["lstm_states"]
        normalised: VecNormalize = state["normalize"]
        normalised.set_venv(state["venv"])
        model.set_env(normalised, force_reset=False)
        env.close()
    except Exception as error:
        raise RunError(f"{checkpoint} cannot be read ({type(error).__name__}: {error})") from error

    def restore_streams() -> None:
        vars(model)["action_noise"] = state["action_noise"]
        torch.set_rng_state(state["torch"])
        np.random.set_state(state["numpy"])
        random.setstate(state["python"])
        model.action_space.np_random.bit_generator.state = state["actions"]
        log = model.logger
        kept: tuple[dict[str, Any], ...] = (log.name_to_value, log.name_to_count, log.name_to_excluded)
        for present, saved in zip(kept, state["log"], strict=True):
            present.update(saved)

    return model, state["progress"], restore_streams
