"""An agent's files: Stable-Baselines3's archive, the normalisation, and the policy file."""

import io
import pickle
from pathlib import Path

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.config import MODEL, NORMALISATION, Config
from capsule_gym import Policy
from capsule_gym.files import write_atomically
from capsule_gym.policies.conversion import read_agent
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


def export(name: str, model: BaseAlgorithm, config: Config, revision: str) -> Policy:
    """The deterministic policy of an agent."""
    return Policy(
        name=name,
        algorithm=config.algo,
        env_kwargs=config.env_kwargs(),
        training_seed=config.seed,
        revision=revision,
        **read_agent(model, model.get_env()),
    )
