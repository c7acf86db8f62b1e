"""The exported policy acts as the Stable-Baselines3 agent that it was taken from, and so does the agent's archive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", exc_type=ImportError)

import torch
from sb3_contrib import TQC
from stable_baselines3 import A2C, PPO, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.training.export import export
from agents.training.runs import archive
from agents.training.sac import LeanSAC
from capsule_gym import load_policy
from capsule_gym.policy import POLICY
from capsule_gym.sb3 import CapsuleSB3VecEnv

# Largest difference of an action from torch's, which computes in float32.
AGREEMENT = 2e-6
ORIGIN: dict[str, Any] = {"env_kwargs": {"torque_limit": 1.5}, "training_seed": 4, "revision": "abc"}


def make_env() -> VecNormalize:
    """Environments that have seen observations of all sizes."""
    rng = np.random.default_rng(1)
    env = VecNormalize(CapsuleSB3VecEnv(2, seed=0), clip_obs=3.0)
    env.obs_rms.mean[:], env.obs_rms.var[:] = rng.normal(0.0, 0.3, 5), rng.uniform(0.1, 4.0, 5)
    return env


def make_model(algorithm: type[BaseAlgorithm], **policy_kwargs: Any) -> BaseAlgorithm:
    """An agent whose weights are large enough to reach an end of the actions."""
    torch.manual_seed(0)
    env = make_env()
    options = {"buffer_size": 10} if issubclass(algorithm, OffPolicyAlgorithm) else {}
    model = algorithm("MlpPolicy", env, device="cpu", policy_kwargs={"net_arch": [64, 64], **policy_kwargs}, **options)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    env.close()
    return model


@pytest.mark.parametrize(
    ("algorithm", "policy_kwargs", "said"),
    [
        (PPO, {}, ("ppo", "tanh", "clip")),
        (PPO, {"activation_fn": torch.nn.ReLU, "net_arch": [32, 16, 8]}, ("ppo", "relu", "clip")),
        (LeanSAC, {}, ("sac", "relu", "tanh")),
        (TD3, {}, ("td3", "relu", "tanh")),
        (TQC, {}, ("tqc", "relu", "tanh")),
    ],
    ids=["ppo", "ppo with relu", "sac", "td3", "tqc"],
)
def test_it_acts_as_the_agent_does(algorithm, policy_kwargs, said, tmp_path):
    model = make_model(algorithm, **policy_kwargs)
    policy = export("run", model, **ORIGIN)
    assert (policy.algorithm, policy.activation, policy.squashing) == said
    observations = np.random.default_rng(2).normal(0.0, 4.0, (2000, 5)).astype(np.float32)
    env = model.get_vec_normalize_env()
    found, wanted = policy(observations), model.predict(env.normalize_obs(observations), deterministic=True)[0]
    assert np.abs(found - wanted).max() < AGREEMENT
    # The archive needs nothing beside it, takes the environment's own observations, and leaves the agent as it was.
    (tmp_path / "model.zip").write_bytes(archive(model))
    loaded_agent = algorithm.load(tmp_path / "model.zip", device="cpu")
    assert np.array_equal(loaded_agent.predict(observations, deterministic=True)[0], wanted)
    assert np.array_equal(model.predict(env.normalize_obs(observations), deterministic=True)[0], wanted)
    assert "features_extractor_class" not in model.policy_kwargs
    # An end of the range and much of what lies between.
    assert np.abs(found).max() > 0.999
    assert np.ptp(found) > 0.8
    assert (np.abs(found) < 0.9).sum() > 100
    # The statistics and the clip count.
    assert (np.abs(env.normalize_obs(observations)) == 3.0).any()

    policy.save(tmp_path / POLICY)
    loaded = load_policy(tmp_path)
    assert loaded(observations).tobytes() == found.tobytes()
    assert {name: getattr(loaded, name) for name in ORIGIN} == ORIGIN


def test_later_training_does_not_change_what_was_exported():
    model = make_model(PPO)
    policy = export("run", model, **ORIGIN)
    observations = np.ones((3, 5), np.float32)
    before = policy(observations).tobytes()
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.zero_()
    model.get_vec_normalize_env().obs_rms.mean[:] = 7.0
    again = export("run", model, **ORIGIN)
    assert policy(observations).tobytes() == before != again(observations).tobytes()
    assert policy.layers[0][0].any()


@pytest.mark.parametrize(
    ("algorithm", "policy_kwargs", "message"),
    [
        (A2C, {}, "model must be a PPO, SAC, TD3 or TQC agent, got A2C"),
        (PPO, {"activation_fn": torch.nn.ELU}, "linear layers with tanh or ReLU"),
        (PPO, {"net_arch": []}, "linear layers with tanh or ReLU"),
    ],
)
def test_other_agents_are_refused(algorithm, policy_kwargs, message):
    with pytest.raises(ValueError, match=message):
        export("run", make_model(algorithm, **policy_kwargs), **ORIGIN)


def test_exploration_by_state_is_refused():
    env = make_env()
    model = PPO("MlpPolicy", env, device="cpu", use_sde=True, n_steps=8, batch_size=8)
    env.close()
    with pytest.raises(ValueError, match="without gSDE"):
        export("run", model, **ORIGIN)
