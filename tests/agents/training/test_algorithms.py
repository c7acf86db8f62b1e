"""Agents: policy files and archives act like the agent; environments of training, and wrappers."""

import dataclasses
import math
import pickle
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

import capsule_gym
import train as command_line
from agents.training.algorithms import CLASSES, EpisodeMetrics, make_env, make_model, make_noise
from agents.training.config import PPOConfig, RunError, TD3Config
from agents.training.export import export, save
from agents.training.presets import PRESETS
from capsule_gym import load_policy
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.agents.training.small import evaluated, finished, small
from tests.agents.training.wrappers import Swing

LABELS = {
    PPO: ("ppo", "tanh", "clip"),
    SAC: ("sac", "relu", "tanh"),
    TD3: ("td3", "relu", "tanh"),
    TQC: ("tqc", "relu", "tanh"),
}
KINDS = [(PPO, [64, 64]), (PPO, [32, 16, 8]), (SAC, [64, 64]), (TD3, [64, 64]), (TQC, [64, 64])]


@pytest.fixture(params=KINDS, ids=lambda each: f"{each[0].__name__}-{len(each[1])}")
def agent(request):
    """An agent whose weights reach the bounds of the actions, with nontrivial statistics."""
    kind, layers = request.param
    rng = np.random.default_rng(1)
    env = VecNormalize(CapsuleSB3VecEnv(2, seed=0), clip_obs=3.0)
    env.obs_rms.mean[:] = rng.normal(0.0, 0.3, 5)
    env.obs_rms.var[:] = rng.uniform(0.1, 4.0, 5)
    torch.manual_seed(0)
    options = {"buffer_size": 10} if issubclass(kind, OffPolicyAlgorithm) else {}
    network = {"net_arch": layers}
    model = kind("MlpPolicy", env, device="cpu", policy_kwargs=network, **options)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return model


@pytest.fixture
def config(agent):
    algorithm, _, _ = LABELS[type(agent)]
    return dataclasses.replace(PRESETS["direct", algorithm], seed=4)


@pytest.fixture
def policy(agent, config):
    return export("run", agent, config, "abc")


OBSERVATIONS = np.random.default_rng(2).normal(0.0, 4.0, (2000, 5)).astype(np.float32)


def actions_of(model, normalisation):
    actions, _ = model.predict(normalisation.normalize_obs(OBSERVATIONS), deterministic=True)
    return actions


def test_a_policy_acts_as_the_agent(agent, policy):
    env = agent.get_vec_normalize_env()
    actions = policy(OBSERVATIONS)
    # torch computes in float32.
    assert np.abs(actions - actions_of(agent, env)).max() < 2e-6
    # Some actions reach their bounds, and some observations those of the normalisation.
    assert np.abs(actions).max() > 0.999
    assert (np.abs(actions) < 0.9).sum() > 100
    assert (np.abs(env.normalize_obs(OBSERVATIONS)) == 3.0).any()


def test_a_policy_file_holds_the_policy(agent, policy, config, tmp_path):
    save(tmp_path, agent, policy)
    loaded = load_policy(tmp_path)
    assert loaded(OBSERVATIONS).tobytes() == policy(OBSERVATIONS).tobytes()
    assert (loaded.algorithm, loaded.activation, loaded.squashing) == LABELS[type(agent)]
    assert loaded.env_kwargs == evaluated(config.env_kwargs())
    assert (loaded.training_seed, loaded.revision) == (4, "abc")


def test_the_files_of_stable_baselines3_hold_the_agent(agent, policy, tmp_path):
    save(tmp_path, agent, policy)
    loaded = type(agent).load(tmp_path / "model.zip", device="cpu")
    normalisation = pickle.loads((tmp_path / "vecnormalize.pkl").read_bytes())
    expected = actions_of(agent, agent.get_vec_normalize_env())
    assert np.array_equal(actions_of(loaded, normalisation), expected)


def test_later_training_does_not_change_an_exported_policy(agent, policy):
    before = policy(OBSERVATIONS)
    with torch.no_grad():
        for parameter in agent.policy.parameters():
            parameter.zero_()
    agent.get_vec_normalize_env().obs_rms.mean[:] = 7.0
    assert np.array_equal(policy(OBSERVATIONS), before)


@pytest.mark.parametrize("algo", CLASSES)
def test_an_archive_loads_without_this_checkout(algo, tmp_path, monkeypatch):
    config = small("direct", algo, total_steps=320, episode_seconds=0.4)
    on_policy = isinstance(config, PPOConfig)
    if not on_policy:
        config = dataclasses.replace(config, n_steps=3, action_noise=0.2)
    run = finished(tmp_path / "run", config)
    for name in list(sys.modules):
        if name.partition(".")[0] in ("agents", "baselines", "train"):
            monkeypatch.setitem(sys.modules, name, None)
    model = CLASSES[algo].load(run / "model.zip", device="cpu")
    assert model.num_timesteps >= 320
    if not on_policy:
        assert model.replay_buffer_class is NStepReplayBuffer
        assert model.replay_buffer_kwargs == {"n_steps": 3, "gamma": config.gamma}
        assert model.action_noise is not None
    package = type(model.policy).__module__.partition(".")[0]
    assert package in ("stable_baselines3", "sb3_contrib", "capsule_gym")
    env = CapsuleSB3VecEnv(2, seed=0, privileged=config.asymmetric)
    normalised = VecNormalize.load(run / "vecnormalize.pkl", env)
    action, _ = model.predict(normalised.reset(), deterministic=True)
    assert action.shape == (2, 1)
    assert normalised.norm_reward is on_policy


@pytest.mark.parametrize(("noise_time", "expected"), [(0.0, 0.0), (0.1, math.exp(-1.0))])
def test_action_noise_has_its_deviation_and_correlation_time(noise_time, expected):
    np.random.seed(0)
    noise = make_noise(TD3Config(action_noise=0.5, noise_time=noise_time))
    # One action.
    assert noise().shape == (1,)
    values = np.array([noise()[0] for _ in range(40_000)])[1000:]
    assert values.mean() == pytest.approx(0.0, abs=0.05)
    assert values.std() == pytest.approx(0.5, rel=0.1)
    # Five steps of 20 ms equal the correlation time.
    correlation = np.corrcoef(values[:-5], values[5:])[0, 1]
    assert correlation == pytest.approx(expected, abs=0.08)


def test_an_off_policy_agent_has_the_hyperparameters_of_its_configuration():
    config = small(
        "direct",
        "tqc",
        gradient_steps=3,
        tau=0.1,
        target_entropy=-2.0,
        quantiles=7,
        dropped_quantiles=3,
    )
    model = make_model(config, make_env(config, 0))
    for name in ("buffer_size", "learning_starts", "gradient_steps", "tau", "target_entropy"):
        assert getattr(model, name) == getattr(config, name)
    assert model.policy.critic.n_quantiles == 7
    assert model.top_quantiles_to_drop_per_net == 3


def test_a_recurrent_agent_has_the_memory_of_its_configuration():
    config = small("direct", "recurrentppo", lstm_units=4)
    assert make_model(config, make_env(config, 0)).policy.lstm_actor.hidden_size == 4


def test_rewards_are_normalised_with_the_discount_and_the_clipping_of_the_agent():
    env = make_env(small("direct", "ppo", gamma=0.9, clip_reward=3.0), 0)
    assert env.gamma == 0.9
    assert env.clip_reward == 3.0


def of_wrappers(attribute):
    return f"tests.agents.training.wrappers:{attribute}"


@pytest.mark.parametrize(
    ("changes", "factors"),
    [
        ({"stack_size": 2}, [2.0, 3.0, 5.0, 1.0, 1.0] * 2),
        ({"wrapper": (of_wrappers("Longer"),)}, [2.0, 3.0, 5.0, 1.0, 1.0, 1.0]),
    ],
)
def test_observations_are_multiplied_by_fixed_factors(changes, factors):
    env = make_env(small("direct", "td3", observation_scale=(2.0, 3.0, 5.0), **changes), 0)
    assert env.normalize_obs(np.ones(len(factors))) == pytest.approx(factors)


WRONG = {
    "Missing": "has no attribute 'Missing'",
    "np": "--wrapper must be MODULE:ATTRIBUTE of a gymnasium.Wrapper",
    "TwoArguments": "weight",
    "Unpicklable": "must be picklable",
}


@pytest.mark.parametrize(("attribute", "reason"), WRONG.items())
def test_a_wrong_wrapper_is_an_error_of_the_command_line(attribute, reason, tmp_path, capsys):
    name = of_wrappers(attribute)
    run = tmp_path / "run"
    words = ["--task", "direct", "--num-envs", "2", "--wrapper", name, "--run", str(run)]
    assert command_line.main(words) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("train.py: error: ")
    for part in ("--wrapper", name, reason):
        assert part in error
    assert not run.exists()


def wrapped(attribute, **changes):
    return small("direct", "ppo", wrapper=(of_wrappers(attribute),), **changes)


def test_a_wrapper_with_discrete_actions_is_refused():
    message = "--wrapper must leave observations and actions Box, got .* and Discrete"
    with pytest.raises(RunError, match=message):
        make_env(wrapped("Discrete"), 0)


def test_wrapped_environments_start_as_their_seed_says():
    config = wrapped("Swing", num_envs=2, initial_range=(1.0, 1.0))
    first, again, other = (make_env(config, seed).venv.reset() for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_wrapped_episode_that_lasts_until_its_time_limit_has_not_failed():
    env = make_env(wrapped("Swing", num_envs=1, episode_seconds=0.04), 0).venv
    env.reset()
    dones = [env.step(np.zeros((1, 1)))[2][0] for _ in range(2)]
    assert dones == [False, True]
    (info,) = env.buf_infos
    assert info["TimeLimit.truncated"]
    assert info["metrics"]["failed"] == 0.0


def test_an_episode_that_a_wrapper_ends_has_its_distance_over_a_whole_one():
    env = gym.make(capsule_gym.ENV_ID, max_episode_steps=100, randomization="none")
    env = EpisodeMetrics(Swing(env))
    env.reset(seed=0)
    terminated = False
    while not terminated:
        _, _, terminated, _, info = env.step(np.ones(1, np.float32))
    metrics = info["metrics"]
    assert metrics["failed"] == 1.0
    assert metrics["distance"] != 0.0
    assert metrics["mean_speed"] == pytest.approx(100.0 * metrics["distance"] / 2.0)


VELOCITY = small(
    "direct",
    "ppo",
    env="CapsuleVelocity-v0",
    disturbances="real",
    command_range=(0.15, 0.16),
    latency_range=(0.0, 0.001),
    residual_limit=1.0,
    training_limit=1.2,
)


def test_training_has_commands_sensors_and_a_limit_of_its_own():
    batch = make_env(VELOCITY, 0).venv.batch
    _, info = batch.reset(seed=0)
    assert 0.15 <= info["command"].min() < info["command"].max() <= 0.16
    assert 0.0 <= info["disturbances"]["latency"].max() <= 0.001
    assert batch.simulation.options.residual_limit == 1.2


def test_a_policy_does_not_have_the_limits_of_its_training():
    policy_limits = {"task": "velocity", "residual_limit": 1.0, "disturbances": "real"}
    assert policy_limits.items() <= VELOCITY.env_kwargs().items()


def test_direct_torque_has_no_control_law():
    message = "^controller must be None with direct torque, got 'baselines:pd'$"
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(VELOCITY, controller="baselines:pd").check()


def test_the_environment_of_direct_torque_has_no_control_law():
    env = make_env(PPOConfig(action_mode="direct"), 0)
    assert env.venv.batch.simulation.options.controller is None


def test_another_environment_has_no_commands():
    with pytest.raises(ValueError, match="command_range must be None in CapsuleGoal-v0"):
        make_env(dataclasses.replace(VELOCITY, env="CapsuleGoal-v0"), 0)
