"""The folder of a training run: what lies in it, and how an agent is written so that nothing is lost.

    config.json          algorithm, hyperparameters, environment, seed, package versions, git revision
    policy.safetensors   the last policy, to use: `capsule_gym.load_policy`; not of an agent with a memory
    model.zip            the last agent, for Stable-Baselines3: `PPO.load`
    best/                the same files for the best evaluation so far
    checkpoint-STEPS/    everything that --resume needs, as `agents.training.checkpoint` says; the last two
    evaluations.csv      the evaluations while training
    logs/                progress.csv and TensorBoard events
    lock                 the process that trains it

While an agent learns, `VecNormalize` stands between it and the environments. Its archive holds that normalisation as
the first layer of its networks (`Normalised`): what `PPO.load` gives acts on the environment's own observations.
Archives contain pickles, which can run any code when loaded: load only what you trust. A policy file contains none.
"""

from __future__ import annotations

import io
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.ppo import CapsulePPO
from agents.training.presets import MODEL
from agents.training.sac import LeanSAC
from capsule_gym import Policy
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "ppo": CapsulePPO,
    "sac": LeanSAC,
    "td3": TD3,
    "tqc": TQC,
    "recurrent-ppo": RecurrentPPO,
}


@dataclass(frozen=True)
class Normalisation:
    """Observations shifted and scaled to zero mean and unit variance, then clipped.

    Attributes:
        mean: shape (entries,), float64.
        var: shape (entries,), float64.
        clip: largest normalised value.
        epsilon: added to the variance.
    """

    mean: np.ndarray
    var: np.ndarray
    clip: float
    epsilon: float

    @classmethod
    def of(cls, model: BaseAlgorithm) -> Normalisation:
        """The present statistics of the environments that an agent learns in."""
        env = model.get_vec_normalize_env()
        assert isinstance(env, VecNormalize)
        rms: Any = env.obs_rms
        return cls(rms.mean.copy(), rms.var.copy(), env.clip_obs, env.epsilon)


class Normalised(BaseFeaturesExtractor):
    """The normalisation as the first layer of a network; it has nothing to learn and is no part of the state dict."""

    mean: torch.Tensor
    scale: torch.Tensor

    def __init__(self, observation_space: spaces.Box, normalisation: Normalisation) -> None:
        super().__init__(observation_space, int(np.prod(observation_space.shape)))
        self.normalisation = normalisation
        scale = np.sqrt(normalisation.var + normalisation.epsilon)
        self.register_buffer("mean", torch.from_numpy(normalisation.mean), persistent=False)
        self.register_buffer("scale", torch.from_numpy(scale), persistent=False)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Normalised observations, float32, by the arithmetic of `VecNormalize`."""
        scaled = (observations.double() - self.mean) / self.scale
        return scaled.clamp(-self.normalisation.clip, self.normalisation.clip).float()


# What an archive's networks are made with and those in training are not.
_FIRST_LAYER = ("features_extractor_class", "features_extractor_kwargs")


def archive(model: BaseAlgorithm) -> bytes:
    """SB3's archive of an agent, its normalisation inside.

    Made in memory, since on a full disk SB3's writer fails with an error of its own.
    """
    content = io.BytesIO()
    kwargs: dict[str, Any] = model.policy_kwargs
    layer = (Normalised, {"normalisation": Normalisation.of(model)})
    try:
        model.policy_kwargs = {**kwargs, **dict(zip(_FIRST_LAYER, layer, strict=True))}
        model.save(content)
    finally:
        model.policy_kwargs = kwargs
    return content.getvalue()


def unarchive(path: Path, algo: str, env: VecNormalize) -> BaseAlgorithm:
    """The agent of an archive as it learned: the environments normalise, not its networks. This unpickles.

    Args:
        path: the archive.
        algo: the algorithm's name.
        env: what it learns in.
    """
    data, _, _ = load_from_zip_file(path, device="cpu")
    assert data is not None
    kwargs = {name: value for name, value in data["policy_kwargs"].items() if name not in _FIRST_LAYER}
    kind = ALGORITHMS[algo]
    return kind.load(path, env=env, device="cpu", force_reset=False, custom_objects={"policy_kwargs": kwargs})


def save(folder: Path, model: BaseAlgorithm, policy: Any) -> None:
    """Writes an agent, and its policy where that has a file, into a folder, each whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / MODEL, archive(model))
    if isinstance(policy, Policy):
        policy.save(folder / POLICY)


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
