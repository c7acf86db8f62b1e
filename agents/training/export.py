"""Takes the deterministic policy out of a Stable-Baselines3 agent, with the normalisation of its observations."""

from __future__ import annotations

from typing import Any

import numpy as np
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from agents.training.collection import RolloutVecEnv
from agents.training.ppo import ActorCritic, FastTanh
from agents.training.runs import Normalisation
from capsule_gym import Policy

ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", FastTanh: "tanh", nn.ReLU: "relu"}


def export(
    name: str,
    model: BaseAlgorithm,
    *,
    env_kwargs: dict[str, Any],
    training_seed: int,
    revision: str,
) -> Policy:
    """The policy that an agent acts by when it acts deterministically; `Policy.save` writes it.

    Args:
        name: for messages and tables.
        model: a PPO, SAC, TD3 or TQC agent with a plain network of linear layers, tanh or ReLU between them, and with
            its environments, which normalise its observations.
        env_kwargs: the arguments of the environment that it was trained in.
        training_seed: the seed of the training run.
        revision: the git revision that it runs at.

    Raises:
        ValueError: if the agent is of another kind.
    """
    if isinstance(model, PPO):
        own = isinstance(model.policy, ActorCritic)
        algorithm, squashing = "ppo", "tanh" if own and model.policy.tanh_mean else "clip"
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
    venv = env.venv
    added = venv.header if isinstance(venv, RolloutVecEnv) else None
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
