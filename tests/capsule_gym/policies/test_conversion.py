"""Networks of torch and agents of Stable-Baselines3 as policies."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize
from torch import nn

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Policy, load_policy
from capsule_gym.sb3 import CapsuleSB3VecEnv

KWARGS = {"randomization": "wide", "torque_limit": 1.2}
ENTRIES = 5


def native_env():
    return CapsuleSB3VecEnv(1, **KWARGS)


def plain_env():
    return make_vec_env("capsule_gym:CapsuleStickSlip-v0", env_kwargs=KWARGS)


def assert_same_actions(policy, model, normalise=lambda observations: observations):
    """Compares the actions in four episodes."""
    env = CapsuleVectorEnv(4, **KWARGS)
    observed, _ = env.reset(seed=1)
    act = policy.start(range(4))
    state = None
    starts = np.ones(4, bool)
    for _ in range(30):
        expected, state = model.predict(
            normalise(observed), state=state, episode_start=starts, deterministic=True
        )
        actions = act(observed, starts)
        # The agent computes in float32.
        np.testing.assert_allclose(actions, expected, rtol=0.0, atol=2e-6)
        observed, _, terminated, truncated, _ = env.step(actions)
        starts = terminated | truncated


@pytest.mark.parametrize("make_env", [native_env, plain_env])
@pytest.mark.parametrize("algorithm", [PPO, A2C, SAC, TD3, DDPG, TQC, RecurrentPPO])
def test_an_agent_becomes_a_policy(algorithm, make_env):
    kind = "MlpLstmPolicy" if algorithm is RecurrentPPO else "MlpPolicy"
    model = algorithm(kind, make_env(), seed=3, device="cpu")
    policy = Policy.from_sb3(model)
    assert policy.env_kwargs == KWARGS
    assert policy.training_seed == 3
    assert policy.name == policy.algorithm == algorithm.__name__.lower()
    assert_same_actions(policy, model)


@pytest.mark.parametrize("algorithm", [PPO, RecurrentPPO])
def test_the_normalisation_of_observations_comes_along(algorithm):
    env = VecNormalize(native_env())
    env.reset()
    for _ in range(50):
        env.step(np.ones((1, 1), np.float32))
    env.training = False
    kind = "MlpLstmPolicy" if algorithm is RecurrentPPO else "MlpPolicy"
    model = algorithm(kind, env, seed=0, device="cpu")
    assert_same_actions(Policy.from_sb3(model), model, env.normalize_obs)


def test_relu_and_gsde_are_converted():
    options = {"use_sde": True, "policy_kwargs": {"activation_fn": nn.ReLU, "squash_output": True}}
    model = PPO("MlpPolicy", native_env(), device="cpu", **options)
    policy = Policy.from_sb3(model, name="mine")
    assert (policy.name, policy.training_seed) == ("mine", 0)
    assert_same_actions(policy, model)


class Doubled(FlattenExtractor):
    """Features that are not the observation."""

    def forward(self, observations):
        return 2.0 * super().forward(observations)


def test_an_agent_with_other_features_is_refused():
    options = {"policy_kwargs": {"features_extractor_class": Doubled}}
    model = PPO("MlpPolicy", native_env(), device="cpu", **options)
    with pytest.raises(ValueError, match="model must be an agent that takes the observation as it"):
        Policy.from_sb3(model)


def test_an_agent_without_its_environment_is_refused():
    model = PPO("MlpPolicy", native_env(), device="cpu")
    model.env = None
    with pytest.raises(ValueError, match="env must be the environment of the training, got None"):
        Policy.from_sb3(model)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"policy_kwargs": {"activation_fn": nn.ELU}}, "module must consist of .* got ELU"),
        ({"use_sde": True}, r"(?s)module must consist of .* got .*Hardtanh"),
    ],
)
def test_an_agent_with_another_network_is_refused_with_the_reason(options, message):
    model = SAC("MlpPolicy", native_env(), device="cpu", **options)
    with pytest.raises(ValueError, match=message):
        Policy.from_sb3(model)


def test_an_lstm_of_two_layers_is_refused():
    options = {"policy_kwargs": {"n_lstm_layers": 2}}
    model = RecurrentPPO("MlpLstmPolicy", native_env(), device="cpu", **options)
    with pytest.raises(ValueError, match="a GRU or an LSTM of one layer"):
        Policy.from_sb3(model)


def test_an_agent_of_another_algorithm_is_refused():
    model = DQN("MlpPolicy", DummyVecEnv([lambda: gym.make("CartPole-v1")]), device="cpu")
    with pytest.raises(TypeError, match=r"model must be an agent of PPO, .* got DQN"):
        Policy.from_sb3(model)


def test_an_agent_of_another_environment_is_refused():
    model = PPO("MlpPolicy", DummyVecEnv([lambda: gym.make("Pendulum-v1")]), device="cpu")
    with pytest.raises(ValueError, match="model must be an agent whose actions are Box"):
        Policy.from_sb3(model)


def test_stacked_frames_are_refused():
    model = PPO("MlpPolicy", VecFrameStack(plain_env(), 2), device="cpu")
    with pytest.raises(ValueError, match=r"env must be without other wrappers .*VecFrameStack"):
        Policy.from_sb3(model)


def test_a_wrapper_that_changes_observations_is_refused():
    def scaled():
        space = gym.spaces.Box(-np.inf, np.inf, (ENTRIES,), np.float32)
        return gym.wrappers.TransformObservation(CapsuleEnv(), lambda x: 2.0 * x, space)

    model = PPO("MlpPolicy", DummyVecEnv([CapsuleEnv, scaled]), device="cpu")
    with pytest.raises(ValueError, match="env must be without an ObservationWrapper"):
        Policy.from_sb3(model)


def test_a_single_environment_gives_its_arguments():
    model = PPO("MlpPolicy", plain_env(), device="cpu")
    env = gym.make("capsule_gym:CapsuleStickSlip-v0", randomization="real-wide")
    assert Policy.from_sb3(model, env).env_kwargs == {"randomization": "real-wide"}


def test_a_network_of_torch_becomes_a_policy():
    torch.manual_seed(0)
    parts = [nn.Linear(ENTRIES, 8), nn.ReLU(), nn.Dropout(), nn.Linear(8, 1), nn.Tanh()]
    network = nn.Sequential(*parts).double().eval()
    values = np.random.default_rng(0).normal(size=(50, ENTRIES)).astype(np.float32)
    actions = Policy.from_torch(nn.Sequential(*parts).float())(values)
    with torch.no_grad():
        expected = network.double()(torch.from_numpy(values.astype(np.float64)))
    np.testing.assert_allclose(actions, expected, rtol=0.0, atol=1e-7)


def test_layers_without_biases_are_converted():
    torch.manual_seed(0)
    cell = nn.GRU(6, 4, bias=False)
    first = nn.Linear(ENTRIES, 6, bias=False)
    last = nn.Linear(4, 1, bias=False)
    policy = Policy.from_torch(nn.Sequential(first, nn.Tanh(), cell, last))
    values = np.random.default_rng(0).normal(size=(3, ENTRIES)).astype(np.float32)
    actions = policy.start(range(3))(values)
    with torch.no_grad():
        hidden, _ = cell(torch.tanh(first(torch.from_numpy(values)))[None])
        expected = last(hidden[0])
    np.testing.assert_allclose(actions, expected, rtol=0.0, atol=1e-6)
    assert policy.training_seed == 0


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([nn.Linear(ENTRIES, 8), nn.Linear(8, 1)], "with Tanh or with ReLU after every hidden"),
        (
            [nn.Linear(ENTRIES, 8), nn.Tanh(), nn.Linear(8, 8), nn.ReLU(), nn.Linear(8, 1)],
            "with Tanh or with ReLU after every hidden",
        ),
        ([nn.Linear(ENTRIES, 8), nn.GELU(), nn.Linear(8, 1)], "module must consist of .* got GELU"),
        ([nn.Linear(ENTRIES, 1), nn.ReLU()], "ends with a linear layer or with Tanh"),
        ([nn.GRU(ENTRIES, 8), nn.GRU(8, 8), nn.Linear(8, 1)], "at most one recurrent cell"),
        ([nn.GRU(ENTRIES, 8, bidirectional=True), nn.Linear(16, 1)], "one direction"),
        ([nn.GRU(ENTRIES, 8)], "whose last layer is linear"),
        ([nn.Linear(4, 1)], r"layers.0.weight must be float32 of shape \(1, 5\)"),
    ],
)
def test_what_cannot_be_converted_is_named_with_its_reason(parts, message):
    with pytest.raises(ValueError, match=message):
        Policy.from_torch(nn.Sequential(*parts))


def test_an_archive_of_an_agent_names_the_conversion(tmp_path):
    path = tmp_path / "model.zip"
    PPO("MlpPolicy", native_env(), device="cpu").save(path)
    with pytest.raises(ValueError, match=r"Policy\.from_sb3\(PPO\.load"):
        load_policy(path)
