"""Configurations small enough to train within a test, and whether two runs are the same, bit for bit."""

from __future__ import annotations

import csv
import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.save_util import load_from_zip_file

from agents.training.loop import begin, train
from agents.training.presets import PRESETS, Config
from capsule_gym import load_policy
from capsule_gym.policy import POLICY

SMALL = {"num_envs": 8, "batch_size": 64, "hidden": 8, "evaluation_episodes": 2, "evaluate_every": 10_000}
# Columns of times, and counts since the last resumption.
CLOCKS = ("seconds", "core_seconds", "time/fps", "time/time_elapsed", "time/iterations")


def small(task: str, algo: str, **changes: Any) -> Config:
    on_policy = algo in ("ppo", "recurrent-ppo")
    extra = {"n_steps": 32, "n_epochs": 2} if on_policy else {"learning_starts": 300, "buffer_size": 2000}
    return dataclasses.replace(PRESETS[task, algo], **{**SMALL, **extra, **changes})


def finished(folder: Path, config: Config) -> Path:
    """A complete run."""
    begin(folder, config)
    assert train(folder, config)
    return folder


def weights(model: Any) -> np.ndarray:
    return torch.cat([p.detach().flatten() for p in model.policy.parameters()]).numpy()


def parameters(archive: Path) -> dict[str, Any]:
    """Networks and optimisers of an archive, without unpickling."""
    _, states, variables = load_from_zip_file(archive, load_data=False, device="cpu")
    return {"states": states, "variables": variables}


def network(folder: Path) -> bytes:
    """The numbers of the policy in a folder, whatever run it says that it is of; none where it has no file."""
    if not (folder / POLICY).is_file():
        return b""
    policy = load_policy(folder / POLICY)
    return b"".join(array.tobytes() for array in (policy.mean, policy.variance, *itertools.chain(*policy.layers)))


def same(a: Any, b: Any) -> bool:
    """Whether two nests of containers hold the same bits."""
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def rows(path: Path, without: tuple[str, ...] = ()) -> list[dict[str, str]]:
    """The lines of a CSV file; none where a run was too short to write one."""
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return [{name: value for name, value in row.items() if name not in without} for row in csv.DictReader(file)]


def differences(run: Path, other: Path) -> list[str]:
    """The files in which two finished runs differ."""
    found = []
    for folder in (Path(), Path("best")):
        if not same(parameters(run / folder / "model.zip"), parameters(other / folder / "model.zip")):
            found.append(str(folder / "model.zip"))
        if network(run / folder) != network(other / folder):
            found.append(str(folder / POLICY))
    for table in ("evaluations.csv", "logs/progress.csv"):
        if rows(run / table, CLOCKS) != rows(other / table, CLOCKS):
            found.append(table)
    return found
