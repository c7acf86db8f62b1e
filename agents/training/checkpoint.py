"""The folder of a training run, its lock and its checkpoints.

    config.json          algorithm, hyperparameters, environment, seed, package versions, git revision
    policy.safetensors   the last policy: `capsule_gym.load_policy`; not of an LSTM or under wrappers
    model.zip            the last agent, for Stable-Baselines3: `PPO.load`
    best/                the same files for the best evaluation so far
    checkpoint-STEPS/    everything that --resume needs; the last two:
        manifest.json        the sha256 of every other file
        model.zip            Stable-Baselines3's archive: networks, optimiser, schedule, last observation
        state.pkl            environments, normalisation, random streams, what the log has not written yet
        replay_buffer.pkl    of off-policy algorithms
        progress.json        step counts, evaluation scores, statistics of the last episodes
        best/                the best model so far
    evaluations.csv      the evaluations while training
    logs/                progress.csv and TensorBoard events
    lock                 held by the process that trains the run

A run that is resumed from a checkpoint ends with the same policy, bit for bit, as one that was not stopped. A
checkpoint is written between two updates into `checkpoint-STEPS.partial`, synchronised to the disk, and renamed; only
then the one before the last is deleted. Archives and .pkl files contain pickles, which can run any code when loaded:
resume only runs of your own. A policy file contains none.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import pickle
import random
import shutil
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

from agents.training.export import archive, unarchive
from agents.training.presets import BEST, MODEL, RunError
from capsule_gym.files import file_hash, naming, synchronise, to_json, write_atomically

LOCK = "lock"
MANIFEST, STATE, REPLAY_BUFFER, PROGRESS = "manifest.json", "state.pkl", "replay_buffer.pkl", "progress.json"
FORMAT = 4
# Suffixes of folders that are not complete yet, or being deleted.
PARTIAL, DISCARDED = ".partial", ".discarded"


@dataclass
class Progress:
    """How far a run is.

    Attributes:
        total_steps: the end of the learning rate's schedule.
        elapsed: seconds of training.
        core_seconds: processor seconds of training.
        evaluated_at: agent steps at the last evaluation.
        best_score: of the best evaluation so far, cm/s.
        resumed_at: agent steps at which the run was resumed.
        speeds: mean speeds of the last episodes, cm/s.
        failed: whether each of them failed.
        recent: their other logged values, by name; None where a value is infinite.
    """

    total_steps: int
    elapsed: float = 0.0
    core_seconds: float = 0.0
    evaluated_at: int = 0
    best_score: float | None = None
    resumed_at: list[int] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    failed: list[float] = field(default_factory=list)
    recent: dict[str, list[float | None]] = field(default_factory=dict)

    @classmethod
    def read(cls, checkpoint: Path) -> Progress:
        """Reads the progress of a checkpoint."""
        path = checkpoint / PROGRESS
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (TypeError, ValueError) as error:
            raise RunError(f"{path} is no progress of a run: {error}") from error


# --- the run's folder ------------------------------------------------------------------------------------------------


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Locks a run's folder for this process. The system releases the lock when the process ends, however it ends.

    Args:
        run: a folder that exists.

    Raises:
        RunError: if another process holds the lock.
        OSError: if the folder cannot be written to.
    """
    lock = filelock.FileLock(run / LOCK, timeout=0)
    try:
        lock.acquire()
    except filelock.Timeout:
        raise RunError(f"{run} is being trained already, by another process") from None
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


def clean_up(run: Path) -> None:
    """Removes temporary files and folders of a process that was killed while it wrote."""
    for pattern in (f"checkpoint-*{PARTIAL}", f"checkpoint-*{DISCARDED}"):
        for folder in run.glob(pattern):
            _remove(folder)
    for folder in (run, run / BEST):
        for file in folder.glob(".*.tmp*"):
            file.unlink()


# --- folders of checkpoints ------------------------------------------------------------------------------------------


def name_of(steps: int) -> str:
    """The name of the checkpoint at that many agent steps; the order of names is the order of steps."""
    return f"checkpoint-{steps:012d}"


def write(run: Path, steps: int, fill: Callable[[Path], None], before: Path | None) -> Path:
    """Writes a checkpoint atomically, and deletes all older ones but the one before it.

    Args:
        run: the run's folder.
        steps: agent steps so far.
        fill: writes the files into the folder that it is given.
        before: the checkpoint before this one.

    Returns:
        Its folder.

    Raises:
        OSError: if it cannot be written; the older ones stay as they were.
    """
    final = run / name_of(steps)
    partial = final.with_suffix(PARTIAL)
    _remove(partial)
    try:
        partial.mkdir()
        fill(partial)
        files = sorted(path for path in partial.rglob("*") if path.is_file())
        hashes = {path.relative_to(partial).as_posix(): file_hash(path) for path in files}
        _write(partial / MANIFEST, to_json({"format": FORMAT, "sha256": hashes}).encode())
        for path in (*partial.rglob("*"), partial):
            synchronise(path)
        _discard(final)
        os.replace(partial, final)
        synchronise(run)
    except OSError:
        # Frees space on a full disk for the last files of the run.
        _remove(partial)
        raise
    for folder in run.glob("checkpoint-*"):
        if folder not in (final, before):
            _discard(folder)
    return final


def newest(run: Path) -> Path | None:
    """The newest checkpoint of a run, damaged or not."""
    return max(_complete(run), default=None)


def newest_whole(run: Path) -> Path | None:
    """The newest undamaged checkpoint of a run; damaged ones are named on stderr.

    Raises:
        RunError: if there are checkpoints, but all of them are damaged.
    """
    damaged: list[str] = []
    for folder in sorted(_complete(run), reverse=True):
        reason = damage(folder)
        if reason is None:
            for line in damaged:
                print(f"warning: {line}; resuming from {folder.name}", file=sys.stderr)
            return folder
        damaged.append(f"{folder} is damaged ({reason})")
    if damaged:
        raise RunError(f"{run} has no whole checkpoint: {'; '.join(damaged)}")
    return None


def damage(folder: Path) -> str | None:
    """What is wrong with a checkpoint's files, in words; None for nothing."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        hashes = manifest["sha256"]
        if manifest["format"] != FORMAT:
            return f"{MANIFEST} has the format {manifest['format']!r}, expected {FORMAT}"
        for name, expected in hashes.items():
            if not (folder / name).is_file():
                return f"{name} is missing"
            if file_hash(folder / name) != expected:
                return f"{name} is not what was written"
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return f"{MANIFEST} cannot be read: {error}"
    return None


def _complete(run: Path) -> list[Path]:
    return [path for path in run.glob("checkpoint-*") if path.suffix not in (PARTIAL, DISCARDED)]


def _discard(folder: Path) -> None:
    """Deletes a checkpoint; its name never stands for a part of it."""
    if folder.suffix not in (PARTIAL, DISCARDED) and folder.exists():
        folder = folder.rename(folder.with_suffix(DISCARDED))
    _remove(folder)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def _write(path: Path, content: bytes) -> None:
    with naming(path):
        path.write_bytes(content)


# --- content of a checkpoint -----------------------------------------------------------------------------------------


def fill(folder: Path, model: BaseAlgorithm, progress: Progress) -> None:
    """Writes the state of a run between two updates.

    Args:
        folder: a folder in the run's; the run's best model is copied into it.
        model: the agent, with its environments and its logger.
        progress: how far the run is.
    """
    _write(folder / MODEL, archive(model))
    _write(folder / STATE, pickle.dumps(_state(model)))
    if isinstance(model, OffPolicyAlgorithm):
        _write(folder / REPLAY_BUFFER, pickle.dumps(model.replay_buffer))
    _write(folder / PROGRESS, to_json(dataclasses.asdict(progress)).encode())
    best = folder.parent / BEST
    if best.is_dir():
        shutil.copytree(best, folder / BEST)


def restore(checkpoint: Path, kind: type[BaseAlgorithm], env: VecNormalize) -> tuple[BaseAlgorithm, Callable[[], None]]:
    """The agent of a checkpoint. This unpickles.

    Args:
        checkpoint: a whole one of the user's own.
        kind: the class of the agent.
        env: fresh environments of the run; those of the checkpoint replace them.

    Returns:
        The agent, and a function that restores the random streams: to be called last, once the agent has its logger.

    Raises:
        RunError: if a file cannot be understood, for example one that other versions wrote.
    """
    path = checkpoint
    try:
        path = checkpoint / STATE
        state = pickle.loads(path.read_bytes())
        path = checkpoint / MODEL
        # Making the model seeds its environments: it gets the others afterwards.
        model = unarchive(path, kind, env)
        if isinstance(model, OffPolicyAlgorithm):
            path = checkpoint / REPLAY_BUFFER
            model.replay_buffer = pickle.loads(path.read_bytes())
        path = checkpoint / STATE
        if state["lstm_states"] is not None:
            vars(model)["_last_lstm_states"] = state["lstm_states"]
        normalised: VecNormalize = state["normalize"]
        normalised.set_venv(state["venv"])
        model.set_env(normalised, force_reset=False)
        env.close()
    except Exception as error:
        raise RunError(f"{path} cannot be understood ({type(error).__name__}: {error})") from error
    return model, lambda: _restore_streams(model, state)


def restore_best(checkpoint: Path | None, run: Path) -> None:
    """Replaces the run's best model by that of a checkpoint; None is the start of the run, which has none."""
    saved = checkpoint / BEST if checkpoint is not None else None
    if saved is None or not saved.is_dir():
        _remove(run / BEST)
        return
    (run / BEST).mkdir(exist_ok=True)
    for path in sorted(saved.iterdir()):
        write_atomically(run / BEST / path.name, path.read_bytes())


def _state(model: BaseAlgorithm) -> dict[str, Any]:
    """The state that SB3's archive does not hold."""
    env = model.get_vec_normalize_env()
    assert env is not None
    log = model.logger
    return {
        # VecNormalize pickles itself without what it normalises.
        "normalize": env,
        "venv": env.venv,
        "torch": torch.get_rng_state(),
        "numpy": np.random.get_state(),
        "python": random.getstate(),
        "actions": model.action_space.np_random.bit_generator.state,
        # Of RecurrentPPO, whose loading clears it.
        "lstm_states": getattr(model, "_last_lstm_states", None),
        "log": (dict(log.name_to_value), dict(log.name_to_count), dict(log.name_to_excluded)),
    }


def _restore_streams(model: BaseAlgorithm, state: dict[str, Any]) -> None:
    """Restores the random streams, and the values that the log had not written yet."""
    torch.set_rng_state(state["torch"])
    np.random.set_state(state["numpy"])
    random.setstate(state["python"])
    model.action_space.np_random.bit_generator.state = state["actions"]
    log = model.logger
    kept: tuple[dict[str, Any], ...] = (log.name_to_value, log.name_to_count, log.name_to_excluded)
    for present, saved in zip(kept, state["log"], strict=True):
        present.update(saved)
