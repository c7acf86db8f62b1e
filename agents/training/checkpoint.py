"""Checkpoints: all that a run needs to go on as if it had never ended, each whole or absent, the last two of them.

    checkpoint-STEPS/
        manifest.json        the sha256 of every other file
        model.zip            Stable-Baselines3's archive: networks, optimiser, schedule, last observation
        state.pkl            environments, normalisation, random streams, what the log has not written yet
        replay_buffer.pkl    of what learns from one
        progress.json        what the run has come to
        best/                the best model so far

A checkpoint is written between two updates into `checkpoint-STEPS.partial`, put on the disk, and renamed; only then the
one before the last goes. It holds pickles, which can run any code when loaded: resume only runs of your own.
"""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import random
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.errors import RunError
from agents.training.presets import BEST, MODEL
from agents.training.runs import archive, unarchive
from capsule_gym.files import file_hash, naming, synchronise, to_json, write_atomically

MANIFEST, STATE, REPLAY_BUFFER, PROGRESS = "manifest.json", "state.pkl", "replay_buffer.pkl", "progress.json"
FORMAT = 3
# Ends of the names of folders that are not there yet, or no longer.
PARTIAL, DISCARDED = ".partial", ".discarded"


@dataclass
class Progress:
    """What a run has come to.

    Attributes:
        total_steps: the end that the learning rate's schedule leads to.
        elapsed: seconds of training.
        core_seconds: of processor time that they took.
        evaluated_at: agent steps at the last evaluation.
        stage: of the run's configuration.
        best_score: of the best evaluation of the stage so far, cm/s.
        resumed_at: agent steps at which the run was gone on with.
        speeds: mean speeds of the last episodes, cm/s.
        failed: whether each of them failed.
        recent: what else is shown of them, by its name in the log; None where it is infinite.
    """

    total_steps: int
    elapsed: float = 0.0
    core_seconds: float = 0.0
    evaluated_at: int = 0
    stage: int = 0
    best_score: float | None = None
    resumed_at: list[int] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    failed: list[float] = field(default_factory=list)
    recent: dict[str, list[float | None]] = field(default_factory=dict)

    @classmethod
    def read(cls, checkpoint: Path) -> Progress:
        """From a checkpoint."""
        path = checkpoint / PROGRESS
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (TypeError, ValueError) as error:
            raise RunError(f"{path} is no progress of a run: {error}") from error


# --- folders ---------------------------------------------------------------------------------------------------------


def name_of(steps: int) -> str:
    """The folder of the checkpoint at that many agent steps; names in order are steps in order."""
    return f"checkpoint-{steps:012d}"


def write(run: Path, steps: int, fill: Callable[[Path], None], before: Path | None) -> Path:
    """Makes a checkpoint, whole or not at all; of the older ones only the one before stays.

    Args:
        run: the run's folder.
        steps: agent steps so far.
        fill: writes its files into the folder that it is given.
        before: the checkpoint that this one follows.

    Returns:
        Its folder.

    Raises:
        OSError: if it cannot be written; the older ones are then as they were.
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
        for path in (*files, *(path for path in partial.rglob("*") if path.is_dir()), partial):
            synchronise(path)
        _discard(final)
        os.replace(partial, final)
        synchronise(run)
    except OSError:
        # A full disk has room again for what ends the run.
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
    """The newest checkpoint of a run whose files are as they were written; says on stderr which ones are not.

    Raises:
        RunError: if there are checkpoints, but all of them are damaged.
    """
    damaged: list[str] = []
    for folder in sorted(_complete(run), reverse=True):
        reason = damage(folder)
        if reason is None:
            for line in damaged:
                print(f"warning: {line}; going on from {folder.name}", file=sys.stderr)
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


def clean_up(run: Path) -> None:
    """Removes what a process left that was killed while it wrote."""
    for pattern in (f"checkpoint-*{PARTIAL}", f"checkpoint-*{DISCARDED}"):
        for folder in run.glob(pattern):
            _remove(folder)
    for folder in (run, run / BEST):
        for file in folder.glob(".*.tmp*"):
            file.unlink()


def _complete(run: Path) -> list[Path]:
    return [path for path in run.glob("checkpoint-*") if path.suffix not in (PARTIAL, DISCARDED)]


def _discard(folder: Path) -> None:
    """Removes a folder, of which there is never a part under its name."""
    if folder.suffix not in (PARTIAL, DISCARDED) and folder.exists():
        folder = folder.rename(folder.with_suffix(DISCARDED))
    _remove(folder)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def _write(path: Path, content: bytes) -> None:
    with naming(path):
        path.write_bytes(content)


# --- content ---------------------------------------------------------------------------------------------------------


def fill(folder: Path, model: BaseAlgorithm, progress: Progress) -> None:
    """Writes the state of a run that stands between two updates.

    Args:
        folder: where; its best model is copied there from beside it.
        model: what learns, with its environments and its log.
        progress: what it has come to.
    """
    _write(folder / MODEL, archive(model))
    _write(folder / STATE, pickle.dumps(_state(model)))
    if isinstance(model, OffPolicyAlgorithm):
        _write(folder / REPLAY_BUFFER, pickle.dumps(model.replay_buffer))
    _write(folder / PROGRESS, to_json(dataclasses.asdict(progress)).encode())
    best = folder.parent / BEST
    if best.is_dir():
        (folder / BEST).mkdir()
        for path in sorted(best.iterdir()):
            _write(folder / BEST / path.name, path.read_bytes())


def restore(checkpoint: Path, algo: str, env: VecNormalize) -> tuple[BaseAlgorithm, Callable[[], None]]:
    """The model as it was.

    Args:
        checkpoint: a whole one of the user's own.
        algo: the algorithm's name.
        env: fresh environments of the run, which become those of the checkpoint.

    Returns:
        The model, and a function that sets the random streams: to be called last, once the model has its log.

    Raises:
        RunError: if a file cannot be understood, as one that other versions wrote.
    """
    path = checkpoint
    try:
        path = checkpoint / STATE
        state = pickle.loads(path.read_bytes())
        path = checkpoint / MODEL
        model = unarchive(path, algo, env)
        if isinstance(model, OffPolicyAlgorithm):
            path = checkpoint / REPLAY_BUFFER
            model.replay_buffer = pickle.loads(path.read_bytes())
        # After the model, whose making seeds the environments and begins its memory anew.
        path = checkpoint / STATE
        if state.get("memory") is not None:
            vars(model)["_last_lstm_states"] = state["memory"]
        _restore_environments(env, state["environments"])
    except Exception as error:
        raise RunError(f"{path} cannot be understood ({type(error).__name__}: {error})") from error
    return model, lambda: _restore_streams(model, state)


def restore_best(checkpoint: Path | None, run: Path) -> None:
    """Makes the run's best model that of a checkpoint; None is the start of the run, which has none."""
    saved = checkpoint / BEST if checkpoint is not None else None
    if saved is None or not saved.is_dir():
        _remove(run / BEST)
        return
    (run / BEST).mkdir(exist_ok=True)
    for path in sorted(saved.iterdir()):
        write_atomically(run / BEST / path.name, path.read_bytes())


def _state(model: BaseAlgorithm) -> dict[str, Any]:
    """What SB3's archive does not hold."""
    env = model.get_vec_normalize_env()
    assert env is not None
    log = model.logger
    # Of RecurrentPPO, whose loading clears it.
    memory = getattr(model, "_last_lstm_states", None)
    return {
        "environments": _environments(env),
        "torch": torch.get_rng_state(),
        "numpy": np.random.get_state(),
        "python": random.getstate(),
        "actions": model.action_space.np_random.bit_generator.state,
        "memory": memory,
        "log": (dict(log.name_to_value), dict(log.name_to_count), dict(log.name_to_excluded)),
    }


def _restore_streams(model: BaseAlgorithm, state: dict[str, Any]) -> None:
    """Sets the random streams, and hands what the log had not written yet to the model's log."""
    torch.set_rng_state(state["torch"])
    np.random.set_state(state["numpy"])
    random.setstate(state["python"])
    model.action_space.np_random.bit_generator.state = state["actions"]
    log = model.logger
    kept: tuple[dict[str, Any], ...] = (log.name_to_value, log.name_to_count, log.name_to_excluded)
    for present, saved in zip(kept, state["log"], strict=True):
        present.update(saved)


# Attributes that are the whole state of a running batch and of what stands around it.
_SIMULATION = ("_keys", "_episodes", "_changes", "_due", "_everyone")
_BATCH = ("_ended", "_started", "_np_random", "_np_random_seed")
_VEC_ENV = ("_returns", "_lengths", "_seed")
_ROLLOUT_VEC_ENV = ("memory", "log_weights", "inputs", "fresh", "over")
_NORMALIZE = ("obs_rms", "ret_rms", "returns", "old_obs", "old_reward")


def _environments(env: VecNormalize) -> dict[str, Any]:
    """The state of running environments and of their normalisation."""
    venv: Any = env.venv
    simulation = venv.batch.simulation
    return {
        "world": simulation.world,
        "observations": simulation.observations,
        "simulation": {name: getattr(simulation, name) for name in _SIMULATION},
        "batch": {name: getattr(venv.batch, name) for name in _BATCH},
        "vec_env": {name: getattr(venv, name) for name in (*_VEC_ENV, *_ROLLOUT_VEC_ENV) if hasattr(venv, name)},
        "normalize": {name: getattr(env, name) for name in _NORMALIZE},
    }


def _restore_environments(env: VecNormalize, state: dict[str, Any]) -> None:
    """Brings fresh environments into that state."""
    venv: Any = env.venv
    simulation = venv.batch.simulation
    # In place: the compiled step knows these arrays by their address.
    simulation.world[:] = state["world"]
    simulation.observations[:] = state["observations"]
    for holder, name in ((simulation, "simulation"), (venv.batch, "batch"), (venv, "vec_env"), (env, "normalize")):
        vars(holder).update(state[name])
