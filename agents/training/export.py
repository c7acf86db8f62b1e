"""An agent's files: Stable-Baselines3's archive, the normalisation of observations, and the policy file."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.training.config import BEST, MODEL, NORMALISATION, Config, RecurrentPPOConfig, read_config
from baselines.evaluation.policies import Policy as EvaluatedPolicy
from baselines.evaluation.policies import wrap_policy
from capsule_gym import Policy, load_policy
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY


def archive(model: BaseAlgorithm) -> bytes:
    """SB3's archive of an agent, written to memory since SB3's writer hides the OSError of a full disk."""
    content = io.BytesIO()
    model.save(content)
    return content.getvalue()


def normalisation(model: BaseAlgorithm) -> VecNormalize:
    """The observation normalisation of an agent's environments."""
    env = model.get_vec_normalize_env()
    assert isinstance(env, VecNormalize)
    return env


def save(folder: Path, model: BaseAlgorithm, policy: EvaluatedPolicy | None) -> None:
    """Writes an agent, and its policy if it can be written to a policy file, into a folder; each file atomically."""
    folder.mkdir(exist_ok=True)
    write_atomically(folder / MODEL, archive(model))
    write_atomically(folder / NORMALISATION, pickle.dumps(normalisation(model)))
    if isinstance(policy, Policy):
        policy.save(folder / POLICY)


def load_best(run: Path) -> EvaluatedPolicy:
    """Loads the best policy of a trusted run: unpickles an agent with an LSTM, and imports the run's control law.

    Raises:
        OSError: if the run has no best agent.
        ValueError: if the folder is not that of a run, has no best policy, or the run was trained with wrappers.
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

    `env` normalises its observations with the current statistics; `env_kwargs` are the arguments of its environment.
    """

    def predict(observations: np.ndarray, **kwargs: Any) -> Any:
        return model.predict(env.normalize_obs(observations), **kwargs)

    return wrap_policy(SimpleNamespace(predict=predict), name=name, env_kwargs=env_kwargs)


def export(name: str, model: BaseAlgorithm, config: Config, revision: str) -> Policy:
    """The deterministic policy of an agent without an LSTM."""
    squashing = "tanh"
    if isinstance(model, PPO):
        squashing = "clip"
        modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    elif isinstance(model, TD3):
        modules = list(model.actor.mu)
    else:
        actor: Any = model.policy.actor
        modules = [*actor.latent_pi, actor.mu]
    layers = [module for module in modules if isinstance(module, nn.Linear)]
    arrays = ((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers)
    env = normalisation(model)
    # With a privileged critic, the observations are dicts.
    rms: Any = env.obs_rms["policy"] if isinstance(env.obs_rms, dict) else env.obs_rms
    return Policy(
        name=name,
        algorithm=config.algo,
        layers=tuple(arrays),
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
