"""The exported policy acts as the Stable-Baselines3 agent that it was taken from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", exc_type=ImportError)

import torch
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.base_class import BaseAlgorithm

from agents.training.export import export
from agents.training.runs import Normalisation, TrainedPolicy
from agents.training.sac import LeanSAC
from agents.training.vec_env import CapsuleSB3VecEnv
from capsule_gym import load_policy
from capsule_gym.policy import POLICY

# Largest difference of an action from torch's, which computes in float32.
AGREEMENT = 2e-6
ORIGIN: dict[str, Any] = {"env_kwargs": {"torque_limit": 1.5}, "training_seed": 4, "revision": "abc"}


def make_model(algorithm: type[BaseAlgorithm], **policy_kwargs: Any) -> BaseAlgorithm:
    """An agent whose weights are large enough to reach an end of the actions."""
    torch.manual_seed(0)
    env = CapsuleSB3VecEnv(2, seed=0)
    options = {} if algorithm is not LeanSAC else {"buffer_size": 10}
    model = algorithm("MlpPolicy", env, device="cpu", policy_kwargs={"net_arch": [64, 64], **policy_kwargs}, **options)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    env.close()
    return model


def make_normalisation() -> Normalisation:
    rng = np.random.default_rng(1)
    return Normalisation(rng.normal(0.0, 0.3, 5), rng.uniform(0.1, 4.0, 5), 100.0, 3.0, 1e-8)


@pytest.mark.parametrize(
    ("algorithm", "policy_kwargs", "said"),
    [
        (PPO, {}, ("ppo", "tanh", "clip")),
        (PPO, {"activation_fn": torch.nn.ReLU, "net_arch": [32, 16, 8]}, ("ppo", "relu", "clip")),
        (LeanSAC, {}, ("sac", "relu", "tanh")),
    ],
    ids=["ppo", "ppo with relu", "sac"],
)
def test_it_acts_as_the_agent_does(algorithm, policy_kwargs, said, tmp_path):
    model, normalisation = make_model(algorithm, **policy_kwargs), make_normalisation()
    policy = export("run", model, normalisation, **ORIGIN)
    assert (policy.algorithm, policy.activation, policy.squashing) == said
    observations = np.random.default_rng(2).normal(0.0, 4.0, (2000, 5)).astype(np.float32)
    act = TrainedPolicy("run", {}, model, normalisation).start([0])
    found, wanted = policy(observations), act(observations)
    assert np.abs(found - wanted).max() < AGREEMENT
    # An end of the range and much of what lies between.
    assert np.abs(found).max() > 0.999
    assert np.ptp(found) > 0.8
    assert (np.abs(found) < 0.9).sum() > 100
    # The statistics and the clip count.
    assert (np.abs((observations - normalisation.mean) / np.sqrt(normalisation.var)) > 3.0).any()

    policy.save(tmp_path / POLICY)
    loaded = load_policy(tmp_path)
    assert loaded(observations).tobytes() == found.tobytes()
    assert {name: getattr(loaded, name) for name in ORIGIN} == ORIGIN


def test_later_training_does_not_change_what_was_exported():
    model = make_model(PPO)
    normalisation = make_normalisation()
    policy = export("run", model, normalisation, **ORIGIN)
    observations = np.ones((3, 5), np.float32)
    before = policy(observations).tobytes()
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.zero_()
    normalisation.mean[:] = 7.0
    again = export("run", model, normalisation, **ORIGIN)
    assert policy(observations).tobytes() == before != again(observations).tobytes()
    assert policy.layers[0][0].any()


@pytest.mark.parametrize(
    ("algorithm", "policy_kwargs", "message"),
    [
        (A2C, {}, "model must be a PPO or SAC agent, got A2C"),
        (PPO, {"activation_fn": torch.nn.ELU}, "linear layers with tanh or ReLU"),
        (PPO, {"net_arch": []}, "linear layers with tanh or ReLU"),
    ],
)
def test_other_agents_are_refused(algorithm, policy_kwargs, message):
    with pytest.raises(ValueError, match=message):
        export("run", make_model(algorithm, **policy_kwargs), make_normalisation(), **ORIGIN)


def test_exploration_by_state_is_refused():
    env = CapsuleSB3VecEnv(2, seed=0)
    model = PPO("MlpPolicy", env, device="cpu", use_sde=True, n_steps=8, batch_size=8)
    env.close()
    with pytest.raises(ValueError, match="without gSDE"):
        export("run", model, make_normalisation(), **ORIGIN)
