"""The folder of a training run: what lies in it, how it is written so that nothing is lost, how a policy is read back.

    config.json          algorithm, hyperparameters, environment, seed, package versions, git revision
    model.zip            the last model
    normalisation.json   the observation's running mean and variance that belong to it
    best/                the same two files for the best evaluation so far
    checkpoint-STEPS/    everything that --resume needs, as `agents.training.checkpoint` says; the last two
    evaluations.csv      the evaluations while training
    logs/                progress.csv and TensorBoard events
    lock                 the process that trains it

Stable-Baselines3 archives (model.zip) contain pickles, which can run any code when loaded: load only what you trust.
"""

from __future__ import annotations

import io
import json
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.presets import BEST, CONFIG, MODEL, NORMALISATION
from agents.training.sac import LeanSAC
from capsule_gym.files import to_json, write_atomically, write_bytes_atomically

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": LeanSAC}


@dataclass(frozen=True)
class Normalisation:
    """Observations shifted and scaled to zero mean and unit variance, then clipped.

    Attributes:
        mean: shape (entries,), float64.
        var: shape (entries,), float64.
        count: number of observations behind them.
        clip: largest normalised value.
        epsilon: added to the variance.
    """

    mean: np.ndarray
    var: np.ndarray
    count: float
    clip: float
    epsilon: float

    @classmethod
    def of(cls, env: VecNormalize) -> Normalisation:
        """The present statistics of a running environment."""
        rms: Any = env.obs_rms
        return cls(rms.mean.copy(), rms.var.copy(), float(rms.count), env.clip_obs, env.epsilon)

    @classmethod
    def read(cls, path: Path) -> Normalisation:
        """From a file."""
        content = json.loads(path.read_text(encoding="utf-8"))
        mean, var = np.array(content["mean"]), np.array(content["var"])
        return cls(mean, var, content["count"], content["clip"], content["epsilon"])

    def write(self, path: Path) -> None:
        """To a file."""
        fields = {**vars(self), "mean": self.mean.tolist(), "var": self.var.tolist()}
        write_atomically(path, to_json(fields))

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Normalised observations, float32."""
        scaled = (observations - self.mean) / np.sqrt(self.var + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


@dataclass(frozen=True)
class TrainedPolicy:
    """A trained network that acts deterministically.

    Attributes:
        name: as it appears in results.
        env_kwargs: the arguments of the environment that it was trained in.
        model: the network.
        normalisation: what its observations go through.
    """

    name: str
    env_kwargs: dict[str, Any]
    model: BaseAlgorithm
    normalisation: Normalisation

    def start(self, seeds: Sequence[int]) -> Callable[[np.ndarray], np.ndarray]:
        """The policy as a function from observations (n, entries) to actions (n, 1)."""
        return lambda observations: self.model.predict(self.normalisation(observations), deterministic=True)[0]


def load_policy(path: Path) -> TrainedPolicy:
    """Reads a trained policy. The archive contains pickles: load only what you trust.

    Args:
        path: a run's folder, whose best model counts if there is one, or a .zip with its normalisation beside it.

    Raises:
        ValueError: if something is missing.
    """
    path = Path(path)
    file = path
    if path.is_dir():
        file = next((p for p in (path / BEST / MODEL, path / MODEL) if p.is_file()), path / MODEL)
    folder = next((p for p in (file.parent, file.parent.parent) if (p / CONFIG).is_file()), file.parent)
    for needed in (file, file.with_name(NORMALISATION), folder / CONFIG):
        if not needed.is_file():
            raise ValueError(f"{path} is no trained policy: {needed} is missing")
    config = json.loads((folder / CONFIG).read_text(encoding="utf-8"))
    model = ALGORITHMS[config["algo"]].load(file, device="cpu")
    return TrainedPolicy(folder.name, config["env"], model, Normalisation.read(file.with_name(NORMALISATION)))


def archive(model: BaseAlgorithm) -> bytes:
    """SB3's archive of a model; made in memory, since on a full disk its writer fails with an error of its own."""
    content = io.BytesIO()
    model.save(content)
    return content.getvalue()


def save_model(folder: Path, model: BaseAlgorithm, normalisation: Normalisation) -> None:
    """Writes model and normalisation into a folder, each whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes_atomically(folder / MODEL, archive(model))
    normalisation.write(folder / NORMALISATION)


def git_revision(folder: Path) -> str:
    """The short git revision of a checkout, "+" behind it where something is not committed; "unknown" outside one."""
    try:
        revision = _git(folder, "rev-parse", "--short=12", "HEAD")
        return revision + ("+" if _git(folder, "status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
