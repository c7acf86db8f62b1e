"""An agent's files: Stable-Baselines3's archive and its normalisation of observations, and the policy file."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.evaluation.policies import Policy as EvaluatedPolicy
from agents.evaluation.policies import wrap_policy
from agents.training.algorithms import FastTanh
from agents.training.presets import BEST, MODEL, NORMALISATION, RecurrentPPOConfig, read_config
from capsule_gym import Policy, load_policy
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY

ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", FastTanh: "tanh", nn.ReLU: "relu"}


def archive(model: BaseAlgorithm) -> bytes:
    """SB3's archive of an agent, made in memory: on a full disk SB3's writer fails with an error of its own."""
    content = io.BytesIO()
    model.save(content)
    return content.getvalue()


def normalisation(model: BaseAlgorithm) -> VecNormalize:
    """What normalises the observations of an agent's environments."""
    env = model.get_vec_normalize_env()
    assert isinstance(env, VecNormalize)
    return env


def save(folder: Path, model: BaseAlgorithm, policy: EvaluatedPolicy | None) -> None:
    """Writes an agent, and its policy where that has a file, into a folder, each file atomically."""
    folder.mkdir(exist_ok=True)
    write_atomically(folder / MODEL, archive(model))
    write_atomically(folder / NORMALISATION, pickle.dumps(normalisation(model)))
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
    env = pickle.loads((run / BEST / NORMALISATION).read_bytes())
    return recurrent_policy(run.name, model, env, config.env_kwargs())


def recurrent_policy(name: str, model: RecurrentPPO, env: VecNormalize, env_kwargs: dict[str, Any]) -> EvaluatedPolicy:
    """The deterministic policy of an agent with an LSTM, which has no policy file.

    Args:
        name: as it appears in results.
        model: the agent.
        env: normalises its observations, with the present statistics.
        env_kwargs: the arguments of the environment that it acts in.
    """

    class Normalising:
        """Predicts from the environment's own observations."""

        def predict(self, observations: np.ndarray, **kwargs: Any) -> Any:
            """As SB3's."""
            return model.predict(env.normalize_obs(observations), **kwargs)

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
    env = normalisation(model)
    rms: Any = env.obs_rms
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
        mean=rms.mean[:inputs].copy(),
        variance=rms.var[:inputs].copy(),
        clip=float(env.clip_obs),
        epsilon=float(env.epsilon),
        env_kwargs=env_kwargs,
        training_seed=training_seed,
        revision=revision,
    )


def _array(parameter: Any) -> np.ndarray:
    """A copy of the numbers, float32."""
    return parameter.detach().cpu().numpy().astype(np.float32)
