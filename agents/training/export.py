"""An agent's files: Stable-Baselines3's archive with its normalisation inside, and the policy file.

While an agent learns, `VecNormalize` normalises the observations of its environments. Its archive holds that
normalisation as the first layer of its networks: what `PPO.load` returns acts on the environment's own observations.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.evaluation.policies import Policy as EvaluatedPolicy
from agents.evaluation.policies import wrap_policy
from agents.training.algorithms import FastTanh
from agents.training.presets import BEST, MODEL, RecurrentPPOConfig, read_config
from capsule_gym import Policy, load_policy
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY

ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", FastTanh: "tanh", nn.ReLU: "relu"}


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
        """The present statistics of an agent's environments."""
        env = model.get_vec_normalize_env()
        assert isinstance(env, VecNormalize)
        rms: Any = env.obs_rms
        return cls(rms.mean.copy(), rms.var.copy(), env.clip_obs, env.epsilon)


class Normalised(BaseFeaturesExtractor):
    """The normalisation as the first layer of a network; it has no parameters and is no part of the state dict."""

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


# Arguments of an archive's networks that those in training do not have.
_FIRST_LAYER = ("features_extractor_class", "features_extractor_kwargs")


def archive(model: BaseAlgorithm) -> bytes:
    """SB3's archive of an agent, with its normalisation.

    It is made in memory: on a full disk SB3's writer fails with an error of its own.
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


def unarchive(path: Path, kind: type[BaseAlgorithm], env: VecNormalize) -> BaseAlgorithm:
    """The agent of an archive as it learned: `env` normalises, not its networks. This unpickles.

    Args:
        path: the archive.
        kind: the agent's class.
        env: what it learns in.
    """
    data, _, _ = load_from_zip_file(path, device="cpu")
    assert data is not None
    kwargs = {name: value for name, value in data["policy_kwargs"].items() if name not in _FIRST_LAYER}
    return kind.load(path, env=env, device="cpu", force_reset=False, custom_objects={"policy_kwargs": kwargs})


def save(folder: Path, model: BaseAlgorithm, policy: EvaluatedPolicy | None) -> None:
    """Writes an agent, and its policy where that has a file, into a folder, each atomically."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / MODEL, archive(model))
    if isinstance(policy, Policy):
        policy.save(folder / POLICY)


def load_best(run: Path) -> EvaluatedPolicy:
    """The best policy of a run of one's own: an LSTM is unpickled, and a control law's code runs.

    Args:
        run: its folder.

    Raises:
        OSError: if it has no best agent.
        RunError: if it is no folder of a run.
        ValueError: if it has no best policy, or was trained with wrappers.
    """
    config = read_config(run)
    if config.wrapper:
        raise ValueError(f"{run} was trained with --wrapper: its {BEST}/{MODEL} acts in these wrappers only")
    if not isinstance(config, RecurrentPPOConfig):
        return load_policy(run, trust_controller=True)
    model = RecurrentPPO.load(run / BEST / MODEL, device="cpu")
    return wrap_policy(model, name=run.name, env_kwargs=config.env_kwargs())


def present_policy(name: str, model: RecurrentPPO, env_kwargs: dict[str, Any]) -> EvaluatedPolicy:
    """The deterministic policy of an agent with an LSTM, which has no policy file.

    Args:
        name: as it appears in results.
        model: the agent, with the environments that it learns in.
        env_kwargs: the arguments of the environment that it acts in.
    """
    env = model.get_vec_normalize_env()
    assert isinstance(env, VecNormalize)
    normalise = env.normalize_obs

    class Normalising:
        """Predicts with the present statistics of the observations."""

        def predict(self, observations: np.ndarray, **kwargs: Any) -> Any:
            """As SB3's."""
            return model.predict(normalise(observations), **kwargs)

    return wrap_policy(Normalising(), name=name, env_kwargs=env_kwargs)


def export(
    name: str,
    model: BaseAlgorithm,
    *,
    env_kwargs: dict[str, Any],
    training_seed: int,
    revision: str,
) -> Policy:
    """The deterministic policy of an agent; `Policy.save` writes it.

    Args:
        name: for messages and tables.
        model: a PPO, SAC, TD3 or TQC agent with a plain network of linear layers, tanh or ReLU between them, and with
            its environments, which normalise its observations.
        env_kwargs: the arguments of the environment that it was trained in.
        training_seed: the seed of the training run.
        revision: the git revision of the code that trained it.

    Raises:
        ValueError: if the agent is of another kind.
    """
    if isinstance(model, PPO):
        # `agents.fast_ppo` adds it to SB3's policy.
        algorithm, squashing = "ppo", "tanh" if getattr(model.policy, "tanh_mean", False) else "clip"
        hidden, last = model.policy.mlp_extractor.policy_net, model.policy.action_net
        squashed = model.policy.squash_output or model.use_sde
    elif isinstance(model, (SAC, TQC)):
        algorithm, squashing = "sac" if isinstance(model, SAC) else "tqc", "tanh"
        hidden, last = model.actor.latent_pi, model.actor.mu
        squashed = model.use_sde
    elif isinstance(model, TD3):
        algorithm, squashing = "td3", "tanh"
        # The tanh is the last layer.
        *layers, last, _ = model.actor.mu
        hidden, squashed = nn.Sequential(*layers), False
    else:
        raise ValueError(f"model must be a PPO, SAC, TD3 or TQC agent, got {type(model).__name__}")
    modules = list(hidden)
    kinds = {ACTIVATIONS.get(type(module)) for module in modules[1::2]}
    linear = [*modules[::2], last]
    plain = all(isinstance(module, nn.Linear) for module in linear) and len(modules) % 2 == 0
    if squashed or not plain or len(kinds) != 1 or None in kinds:
        raise ValueError(
            "model must act by linear layers with tanh or ReLU between them, without gSDE and without further "
            f"squashing, got {hidden} and {last}"
        )
    (activation,) = kinds
    normalisation = Normalisation.of(model)
    env: Any = model.get_env()
    # Inputs and output that `agents.fast_ppo` adds to the environment's.
    added = getattr(env.venv, "header", None)
    inputs = linear[0].in_features
    return Policy(
        name=name,
        algorithm=algorithm,
        layers=tuple((_array(layer.weight), _array(layer.bias)) for layer in linear),
        activation=str(activation),
        squashing=squashing,
        output="torque" if added and added.outputs_torque else "action",
        identifies=bool(added and added.identifies),
        observes_energy_weight=bool(added and added.observes_energy_weight),
        mean=normalisation.mean[:inputs].astype(np.float64),
        variance=normalisation.var[:inputs].astype(np.float64),
        clip=float(normalisation.clip),
        epsilon=float(normalisation.epsilon),
        env_kwargs=env_kwargs,
        training_seed=training_seed,
        revision=revision,
    )


def _array(parameter: Any) -> np.ndarray:
    """A copy of the numbers, float32."""
    return parameter.detach().cpu().numpy().astype(np.float32)
