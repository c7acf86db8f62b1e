"""Agents: policy files and archives act like the agent; environments of training, and wrappers."""

import dataclasses
import math
import pickle
import sys

import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

import train as command_line
from agents.training.algorithms import CLASSES, make_env, make_noise
from agents.training.config import TD3Config
from agents.training.export import export, save
from agents.training.presets import PRESETS
from capsule_gym import load_policy
from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.agents.training.small import finished, small

PLANTS = EvaluationSet(
    "two", (PlantSpec(M=0.5, mu=0.01, seed=0), PlantSpec(M=0.46, mu=0.01, seed=1))
)


def agent(kind, **policy_kwargs):
    """An agent with weights large enough to reach the bounds of the actions, and with nontrivial
    statistics."""
    rng = np.random.default_rng(1)
    env = VecNormalize(CapsuleSB3VecEnv(2, seed=0), clip_obs=3.0)
    env.obs_rms.mean[:], env.obs_rms.var[:] = rng.normal(0.0, 0.3, 5), rng.uniform(0.1, 4.0, 5)
    torch.manual_seed(0)
    options = {"buffer_size": 10} if issubclass(kind, OffPolicyAlgorithm) else {}
    model = kind(
        "MlpPolicy",
        env,
        device="cpu",
        policy_kwargs={"net_arch": [64, 64], **policy_kwargs},
        **options,
    )
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return model


KINDS = [(PPO, {}), (PPO, {"net_arch": [32, 16, 8]}), (SAC, {}), (TD3, {}), (TQC, {})]


@pytest.mark.parametrize(("kind", "policy_kwargs"), KINDS)
def test_policy_file_and_archive_act_as_the_agent(kind, policy_kwargs, tmp_path):
    labels = ("ppo", "tanh", "clip") if kind is PPO else (kind.__name__.lower(), "relu", "tanh")
    model = agent(kind, **policy_kwargs)
    config = dataclasses.replace(PRESETS["direct", labels[0]], seed=4)
    policy = export("run", model, config, "abc")
    assert (policy.algorithm, policy.activation, policy.squashing) == labels
    observations = np.random.default_rng(2).normal(0.0, 4.0, (2000, 5)).astype(np.float32)
    env = model.get_vec_normalize_env()
    found, expected = (
        policy(observations),
        model.predict(env.normalize_obs(observations), deterministic=True)[0],
    )
    assert np.abs(found - expected).max() < 2e-6  # torch computes in float32
    assert np.abs(found).max() > 0.999 and (np.abs(found) < 0.9).sum() > 100
    assert (np.abs(env.normalize_obs(observations)) == 3.0).any()
    # SB3's own files: the agent, and the normalisation of its observations.
    save(tmp_path, model, policy)
    loaded_agent = kind.load(tmp_path / "model.zip", device="cpu")
    normalised = pickle.loads((tmp_path / "vecnormalize.pkl").read_bytes()).normalize_obs(
        observations
    )
    assert np.array_equal(loaded_agent.predict(normalised, deterministic=True)[0], expected)
    # Later training does not change an exported policy.
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.zero_()
    env.obs_rms.mean[:] = 7.0
    assert np.array_equal(policy(observations), found)
    loaded = load_policy(tmp_path)
    assert loaded(observations).tobytes() == found.tobytes()
    assert (loaded.env_kwargs, loaded.training_seed, loaded.revision) == (
        config.env_kwargs(),
        4,
        "abc",
    )


@pytest.mark.parametrize("algo", CLASSES)
def test_an_archive_loads_without_this_checkout(algo, tmp_path, monkeypatch):
    changes = {"n_steps": 3, "action_noise": 0.2} if algo in ("sac", "td3", "tqc") else {}
    run = finished(
        tmp_path / "run", small("direct", algo, total_steps=320, episode_seconds=0.4, **changes)
    )
    for name in [
        name for name in sys.modules if name.partition(".")[0] in ("agents", "baselines", "train")
    ]:
        monkeypatch.setitem(sys.modules, name, None)
    model = CLASSES[algo].load(run / "model.zip", device="cpu")
    assert model.num_timesteps >= 320
    assert type(model.policy).__module__.partition(".")[0] in (
        "stable_baselines3",
        "sb3_contrib",
        "capsule_gym",
    )
    env = CapsuleSB3VecEnv(2, seed=0, privileged=algo == "ppo")
    normalised = VecNormalize.load(run / "vecnormalize.pkl", env)
    action, _ = model.predict(normalised.reset(), deterministic=True)
    assert action.shape == (2, 1) and normalised.norm_reward is (algo == "ppo")


@pytest.mark.parametrize("noise_time", [0.0, 0.1])
def test_action_noise_has_its_deviation_and_correlation_time(noise_time):
    np.random.seed(0)
    noise = make_noise(TD3Config(action_noise=0.5, noise_time=noise_time))
    values = np.array([noise()[0] for _ in range(40_000)])[1000:]
    assert values.std() == pytest.approx(0.5, rel=0.1)
    later = np.corrcoef(values[:-5], values[5:])[0, 1]
    # Five steps of 20 ms equal the correlation time.
    assert later == pytest.approx(math.exp(-1.0) if noise_time else 0.0, abs=0.08)


WRONG = {
    "Missing": "has no attribute 'Missing'",
    "np": "--wrapper must be MODULE:ATTRIBUTE of a gymnasium.Wrapper",
}
WRONG |= {"TwoArguments": "weight", "Unpicklable": "must be picklable"}


@pytest.mark.parametrize(("attribute", "reason"), WRONG.items())
def test_a_wrong_wrapper_is_an_error_of_the_command_line(attribute, reason, tmp_path, capsys):
    name = f"tests.agents.training.wrappers:{attribute}"
    words = [
        "--task",
        "direct",
        "--num-envs",
        "2",
        "--wrapper",
        name,
        "--run",
        str(tmp_path / "run"),
    ]
    assert command_line.main(words) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert (
        error.startswith("train.py: error: ")
        and "--wrapper" in error
        and name in error
        and reason in error
    )
    assert not (tmp_path / "run").exists()


def test_training_has_commands_sensors_and_a_limit_of_its_own():
    ranges = {"command_range": (0.15, 0.16), "latency_range": (0.0, 0.001)}
    limits = {"residual_limit": 1.0, "training_limit": 1.2}
    config = small(
        "direct", "ppo", env="CapsuleVelocity-v0", disturbances="real", **limits, **ranges
    )
    venv = make_env(config, 0).venv
    info = venv.batch.reset(seed=0)[1]
    assert 0.15 <= info["command"].min() < info["command"].max() <= 0.16
    assert (
        0.0 <= info["disturbances"]["latency"].max() <= 0.001
        and venv.batch.simulation.options.residual_limit == 1.2
    )
    with pytest.raises(
        ValueError, match=r"^controller must be None with direct torque, got 'baselines:pd'$"
    ):
        dataclasses.replace(config, controller="baselines:pd").check()
    assert {
        "task": "velocity",
        "residual_limit": 1.0,
        "disturbances": "real",
    }.items() <= config.env_kwargs().items()
    with pytest.raises(ValueError, match="command_range must be None in CapsuleGoal-v0"):
        make_env(dataclasses.replace(config, env="CapsuleGoal-v0"), 0)
