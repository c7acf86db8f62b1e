"""The folder of a training run, whose files docs/training.md lists, its lock and its checkpoints.

A run that is resumed from a checkpoint ends with the same policy, bit for bit, as an uninterrupted
run. A checkpoint is written atomically between two updates; afterwards, all older ones but the
previous one are deleted. Archives, .pkl files and checkpoints contain pickles, which can run any
code when loaded: resume only runs of your own. A policy file contains no pickle.
"""

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
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.config import CONFIG, EVALUATIONS, MODEL, NORMALISATION, RunError
from agents.training.export import archive, normalisation
from capsule_gym.files import synchronise, write_atomically
from capsule_gym.policies.policy import POLICY

LOCK = "lock"
CHECKPOINTS = "checkpoint-" + 12 * "[0-9]"
# Names, without suffix, of the files that the process with the lock replaces; temporary files
# shorten them.
WRITTEN = ["checkpoint-*"]
WRITTEN += [Path(name).stem for name in (CONFIG, EVALUATIONS, MODEL, NORMALISATION, POLICY)]
# Attribute of RecurrentPPO.
MEMORY = "_last_lstm_states"
DIGEST_SIZE = hashlib.sha256().digest_size


@dataclass
class Progress:
    """The progress of a run."""

    settings: dict[str, Any]  # hyperparameters of the run, except total_steps
    core_seconds: float = 0.0  # processor seconds of training
    evaluations: list[dict[str, float]] = field(default_factory=list)  # lines of evaluations.csv
    best_score: float = -np.inf  # score of the best evaluation so far


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Locks a run's folder for this process.

    The system releases the lock when the process ends, also in a crash.

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
        warning = "this file system has no locks; make sure that no second process trains it"
        print(f"{run}: {warning}", file=sys.stderr)
    try:
        yield
    finally:
        lock.release()


def git_revision() -> str:
    """The short git revision of this checkout, with "+" for uncommitted changes.

    "unknown" outside a checkout.
    """
    command = "git describe --always --exclude=* --abbrev=12 --dirty=+".split()
    folder = Path(__file__).parent
    try:
        result = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
        return result.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def path_of(run: Path, steps: int) -> Path:
    """The path of the checkpoint after `steps` agent steps; paths sort by steps."""
    return run / f"checkpoint-{steps:012d}"


def steps_of(path: Path) -> int:
    """The agent steps of a checkpoint, from its path."""
    return int(path.name.removeprefix("checkpoint-"))


def newest_whole(run: Path) -> Path | None:
    """Finds the newest undamaged checkpoint of a run; prints damaged ones to stderr.

    Raises:
        RunError: if there are checkpoints, but all of them are damaged.
    """
    paths = sorted(run.glob(CHECKPOINTS), reverse=True)
    for path in paths:
        if is_whole(path):
            return path
        print(f"warning: {path} is damaged; trying the one before", file=sys.stderr)
    if paths:
        raise RunError(f"{run} has no undamaged checkpoint: {', '.join(map(str, paths))}")
    return None


def is_whole(checkpoint: Path) -> bool:
    """Whether a checkpoint matches its sha256."""
    content = memoryview(checkpoint.read_bytes())
    return hashlib.sha256(content[DIGEST_SIZE:]).digest() == content[:DIGEST_SIZE]


def write(run: Path, model: BaseAlgorithm, progress: Progress, before: Path | None) -> Path:
    """Writes a checkpoint between two updates, and deletes all others but `before`.

    Returns:
        The path of the checkpoint.

    Raises:
        OSError: if the checkpoint cannot be written; the older ones are unchanged.
    """
    env = normalisation(model)
    state = {
        "model": archive(model),
        "progress": progress,
        "replay_buffer": getattr(model, "replay_buffer", None),
        # VecNormalize pickles itself without its environments.
        "normalize": env,
        "venv": env.venv,
        # Discounted sums, from which the scale of the rewards is measured; VecNormalize leaves them
        # out.
        "returns": env.returns,
        "torch": torch.get_rng_state(),
        "numpy": np.random.get_state(),
        "python": random.getstate(),
        "actions": model.action_space.np_random.bit_generator.state,
        # SB3 resets the noise when training continues, and sb3-contrib the memory.
        "action_noise": getattr(model, "action_noise", None),
        "memory": vars(model).get(MEMORY),
        "log": [dict(values) for values in _unwritten(model.logger)],
    }
    content = pickle.dumps(state)
    path = path_of(run, model.num_timesteps)
    write_atomically(path, hashlib.sha256(content).digest() + content)
    synchronise(run)
    for other in run.glob(CHECKPOINTS):
        if other not in (path, before):
            other.unlink()
    return path


def _unwritten(log: Logger) -> tuple[dict[str, Any], ...]:
    """The values that a log has not written yet, with their counts and excluded formats."""
    return log.name_to_value, log.name_to_count, log.name_to_excluded


def restore(
    checkpoint: Path, kind: type[BaseAlgorithm], env: VecNormalize
) -> tuple[BaseAlgorithm, Progress, Callable[[], None]]:
    """Unpickles an undamaged, trusted checkpoint, whose environments replace `env`.

    Returns:
        The agent, the progress, and a function that restores the random streams and the log, to be
        called when the agent begins to learn.

    Raises:
        RunError: if the checkpoint cannot be read, for example because other versions wrote it.
    """
    try:
        state: dict[str, Any] = pickle.loads(checkpoint.read_bytes()[DIGEST_SIZE:])
        # `load` seeds the environments that it gets, so the checkpoint's environments are set
        # afterwards.
        model = kind.load(io.BytesIO(state["model"]), env=env, device="cpu", force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            model.replay_buffer = state["replay_buffer"]
        normalised: VecNormalize = state["normalize"]
        normalised.set_venv(state["venv"])
        normalised.returns = state["returns"]
        model.set_env(normalised, force_reset=False)
        env.close()
    except Exception as error:
        raise RunError(f"{checkpoint} cannot be read ({type(error).__name__}: {error})") from error

    def restore_streams() -> None:
        vars(model)["action_noise"] = state["action_noise"]
        vars(model)[MEMORY] = state["memory"]
        torch.set_rng_state(state["torch"])
        np.random.set_state(state["numpy"])
        random.setstate(state["python"])
        model.action_space.np_random.bit_generator.state = state["actions"]
        for present, saved in zip(_unwritten(model.logger), state["log"], strict=True):
            present.update(saved)

    return model, state["progress"], restore_streams
