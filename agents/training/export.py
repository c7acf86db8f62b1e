"""An agent's files: Stable-Baselines3's archive, the normalisation, and the policy file."""

import io
import pickle
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.training.config import MODEL, NORMALISATION, Config
from capsule_gym import Policy
from capsule_gym.files import write_atomically
from capsule_gym.policies.policy import POLICY


def archive(model: BaseAlgorithm) -> bytes:
    """SB3's archive of an agent.

    Written to memory, since SB3's writer hides the OSError of a full disk.
    """
    content = io.BytesIO()
    model.save(content)
    return content.getvalue()


def normalisation(model: BaseAlgorithm) -> VecNormalize:
    """The observation normalisation of an agent's environments."""
    env = model.get_vec_normalize_env()
    assert isinstance(env, VecNormalize)
    return env


def save(folder: Path, model: BaseAlgorithm, policy: Policy | None) -> None:
    """Writes an agent and, if it has one, its policy into a folder; each file atomically."""
    folder.mkdir(exist_ok=True)
    write_atomically(folder / MODEL, archive(model))
    write_atomically(folder / NORMALISATION, pickle.dumps(normalisation(model)))
    if policy is not None:
        policy.save(folder / POLICY)


def weights_and_biases(modules: Iterable[nn.Module]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Copies of the weights and biases of the linear layers, for a policy file."""
    layers = []
    for module in modules:
        if isinstance(module, nn.Linear):
            parameters = (module.weight, module.bias)
            weights, bias = (each.detach().numpy().copy() for each in parameters)
            layers.append((weights, bias))
    return tuple(layers)


def export(name: str, model: BaseAlgorithm, config: Config, revision: str) -> Policy:
    """The deterministic policy of an agent."""
    squashing = "tanh"
    if isinstance(model, PPO):
        squashing = "clip"
        modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    elif isinstance(model, TD3):
        modules = list(model.actor.mu)
    else:
        actor: Any = model.policy.actor
        modules = [*actor.latent_pi, actor.mu]
    env = normalisation(model)
    # With a privileged critic, the observations are dicts.
    rms: Any = env.obs_rms["policy"] if isinstance(env.obs_rms, dict) else env.obs_rms
    return Policy(
        name=name,
        algorithm=config.algo,
        layers=weights_and_biases(modules),
        activation=config.activation,
        squashing=squashing,
        mean=rms.mean.copy(),
        variance=rms.var.copy(),
        clip=float(env.clip_obs),
        epsilon=float(env.epsilon),
        env_kwargs=config.env_kwargs(),
        training_seed=config.seed,
        revision=revision,
    )
