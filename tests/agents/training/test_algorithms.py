"""Agents: policy files and archives act like the agent, faster classes learn like SB3's; stock classes and wrappers."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

import train as command_line
from agents.evaluation.episodes import evaluate
from agents.training import fast_sac
from agents.training.algorithms import FastSAC, FastTanh, RecurrentPolicy, make_env, make_model, make_noise, usable
from agents.training.config import PPOConfig, RunError, TD3Config
from agents.training.export import export, load_best, recurrent_policy, save
from agents.training.loop import begin, train
from agents.training.presets import PRESETS, ROWS
from capsule_gym import load_policy
from capsule_gym.evaluation_sets import EvaluationSet, PlantSpec
from capsule_gym.files import to_json
from capsule_gym.policy import POLICY
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.agents.training.small import differences, finished, rows, small, train_until, weights

# Largest difference between an action and torch's, which computes in float32.
AGREEMENT = 2e-6
PLANTS = EvaluationSet("two", (PlantSpec(M=0.5, mu=0.01, seed=0), PlantSpec(M=0.46, mu=0.01, seed=1)))
SWING = "tests.agents.training.wrappers:Swing"


# --- policy files and archives ---------------------------------------------------------------------------------------


def agent(kind: type[BaseAlgorithm], **policy_kwargs: Any) -> BaseAlgorithm:
    """An agent with weights large enough to reach the bounds of the actions, and with nontrivial statistics."""
    rng = np.random.default_rng(1)
    env = VecNormalize(CapsuleSB3VecEnv(2, seed=0), clip_obs=3.0)
    env.obs_rms.mean[:], env.obs_rms.var[:] = rng.normal(0.0, 0.3, 5), rng.uniform(0.1, 4.0, 5)
    torch.manual_seed(0)
    options = {"buffer_size": 10} if issubclass(kind, OffPolicyAlgorithm) else {}
    model = kind("MlpPolicy", env, device="cpu", policy_kwargs={"net_arch": [64, 64], **policy_kwargs}, **options)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return model


@pytest.mark.parametrize(
    ("kind", "policy_kwargs", "labels"),
    [
        (PPO, {}, ("ppo", "tanh", "clip")),
        (PPO, {"net_arch": [32, 16, 8]}, ("ppo", "tanh", "clip")),
        (FastSAC, {}, ("sac", "relu", "tanh")),
        (TD3, {}, ("td3", "relu", "tanh")),
        (TQC, {}, ("tqc", "relu", "tanh")),
    ],
    ids=["ppo", "ppo with three layers", "sac", "td3", "tqc"],
)
def test_policy_file_and_archive_act_as_the_agent(kind, policy_kwargs, labels, tmp_path):
    model = agent(kind, **policy_kwargs)
    config = dataclasses.replace(PRESETS["direct", labels[0]], seed=4)
    policy = export("run", model, config, "abc")
    assert (policy.algorithm, policy.activation, policy.squashing) == labels
    observations = np.random.default_rng(2).normal(0.0, 4.0, (2000, 5)).astype(np.float32)
    env = model.get_vec_normalize_env()
    found, expected = policy(observations), model.predict(env.normalize_obs(observations), deterministic=True)[0]
    assert np.abs(found - expected).max() < AGREEMENT
    assert np.abs(found).max() > 0.999 and (np.abs(found) < 0.9).sum() > 100
    assert (np.abs(env.normalize_obs(observations)) == 3.0).any()
    # SB3's own files: the agent, and the normalisation of its observations.
    save(tmp_path, model, policy)
    loaded_agent = kind.load(tmp_path / "model.zip", device="cpu")
    normalised = pickle.loads((tmp_path / "vecnormalize.pkl").read_bytes()).normalize_obs(observations)
    assert np.array_equal(loaded_agent.predict(normalised, deterministic=True)[0], expected)
    # Later training does not change an exported policy.
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.zero_()
    env.obs_rms.mean[:] = 7.0
    assert np.array_equal(policy(observations), found)
    loaded = load_policy(tmp_path)
    assert loaded(observations).tobytes() == found.tobytes()
    assert (loaded.env_kwargs, loaded.training_seed, loaded.revision) == (config.env_kwargs(), 4, "abc")


# --- faster parts of Stable-Baselines3 -------------------------------------------------------------------------------


@pytest.mark.parametrize("n_steps", [1, 3])
def test_fast_sac_makes_the_updates_of_sb3(n_steps):
    results = []
    for stock in (True, False):
        config = small("residual", "sac", learning_starts=400, stock=stock, n_steps=n_steps)
        model: Any = make_model(config, make_env(config, 0))
        assert type(model) is (SAC if stock else FastSAC)
        # The steps are too few for an update, so both agents hold the same transitions and the same networks.
        model.learn(400)
        np.random.seed(0)
        torch.manual_seed(0)
        before = weights(model)
        for _ in range(10):
            model.train(1, 64)
        losses = {name: value for name, value in model.logger.name_to_value.items() if name.startswith("train/")}
        results.append((weights(model), model.log_ent_coef.item(), losses))
        assert not np.array_equal(before, results[-1][0])
    (expected, entropy, losses), (found, own_entropy, own_losses) = results
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    assert own_entropy == pytest.approx(entropy, rel=1e-5)
    assert own_losses == pytest.approx(losses, rel=1e-3, abs=1e-6)


def test_fast_sac_draws_a_new_batch_for_each_update(monkeypatch):
    config = small("residual", "sac", learning_starts=400)
    model: Any = make_model(config, make_env(config, 0))
    model.learn(400)
    batches: list[np.ndarray] = []
    propose = fast_sac.propose
    monkeypatch.setattr(fast_sac, "propose", lambda actor, x, noise: batches.append(x) or propose(actor, x, noise))
    model.train(3, 16)
    assert [batch.shape for batch in batches] == [(16, 10)] * 3
    assert len({batch.tobytes() for batch in batches}) == 3


def test_fast_tanh_is_the_hyperbolic_tangent():
    x = torch.linspace(-12.0, 12.0, 10_001, requires_grad=True)
    (slope,) = torch.autograd.grad(FastTanh()(x).sum(), x)
    exact = torch.tanh(x.detach().double())
    assert (FastTanh()(x) - exact).abs().max() < 2e-7
    assert (slope - (1.0 - exact**2)).abs().max() < 1e-6


def test_fixed_factors_stay_as_they_are():
    env = make_env(small("direct", "sac", observation_scale=(2.0, 0.25, 6.0)), 0)
    shown = env.reset()
    for _ in range(20):
        factors = (2.0, 0.25, 6.0, 1.0, 1.0)
        np.testing.assert_allclose(shown, env.get_original_obs() * np.float32(factors), rtol=1e-6)
        shown = env.step(np.full((env.num_envs, 1), 0.3, np.float32))[0]


@pytest.mark.parametrize("noise_time", [0.0, 0.1])
def test_action_noise_has_its_deviation_and_correlation_time(noise_time):
    np.random.seed(0)
    noise = make_noise(TD3Config(action_noise=0.5, noise_time=noise_time))
    values = np.array([noise()[0] for _ in range(40_000)])[1000:]
    assert values.std() == pytest.approx(0.5, rel=0.1)
    later = np.corrcoef(values[:-5], values[5:])[0, 1]
    # Five steps of 20 ms equal the correlation time.
    assert later == pytest.approx(math.exp(-1.0) if noise_time else 0.0, abs=0.08)


@pytest.mark.parametrize("length", [1, 7])
@pytest.mark.parametrize("begun", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)])
def test_an_lstm_in_one_call_is_the_lstm_step_by_step(length, begun):
    torch.manual_seed(0)
    lstm = torch.nn.LSTM(5, 4)
    starts = torch.zeros(3, length)
    starts[:, 0] = torch.tensor(begun)
    given = (torch.randn(3 * length, 5), (torch.randn(1, 3, 4), torch.randn(1, 3, 4)), starts.flatten(), lstm)
    torch.testing.assert_close(
        RecurrentPolicy._process_sequence(*given), RecurrentActorCriticPolicy._process_sequence(*given)
    )


def test_an_agent_with_an_lstm_is_evaluated_with_its_memory(tmp_path):
    config = small("direct", "recurrent-ppo", total_steps=512, evaluate_every=512)
    run = finished(tmp_path / "run", config)
    assert not list(run.rglob(POLICY))
    with pytest.raises(ValueError, match="policy"):
        load_policy(run)
    first, again = (to_json(evaluate(load_best(run), PLANTS, horizon=0.5)) for _ in range(2))
    assert first == again
    env = make_env(config, 0)
    env.obs_rms.mean[:], env.obs_rms.var[:] = 0.3, 4.0
    model: Any = make_model(config, env)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    act = recurrent_policy("present", model, env, config.env_kwargs()).start([0, 1])
    observations = np.random.default_rng(0).normal(size=(2, 5)).astype(np.float32)
    found = act(observations), act(observations)
    state, begun = None, np.ones(2, bool)
    for actions in found:
        expected, state = model.predict(env.normalize_obs(observations), state, begun, deterministic=True)
        assert np.array_equal(actions, expected)
        begun = np.zeros(2, bool)
    assert np.abs(found[0] - found[1]).min() > 1e-4


# --- stock classes and wrappers --------------------------------------------------------------------------------------


def test_stock_trains_with_sb3s_classes_and_names_the_options_that_it_loses(tmp_path, capsys):
    own = {name: getattr(small("direct", "ppo"), name) for name in ("num_envs", "batch_size", "hidden", "n_steps")}
    config = dataclasses.replace(ROWS["residual-identifying"], **own, controller="baselines:adaptive", stock=True)
    config = dataclasses.replace(usable(config), total_steps=512, evaluate_every=256, evaluation_episodes=2)
    message = capsys.readouterr().err
    for name in ("least-log-std -3.2", "jump-rate 0.1", "identifies True", "privileged-critic True", "critic-steps"):
        assert f"--{name}" in message
    assert "tanh-mean" not in message and "output" not in message
    assert isinstance(config, PPOConfig) and not config.identifies
    env = make_env(config, 0)
    model = make_model(config, env)
    assert (type(model), type(model.policy).__module__, type(env.venv)) == (
        PPO,
        "stable_baselines3.common.policies",
        CapsuleSB3VecEnv,
    )
    run = finished(tmp_path / "run", config)
    observations = np.random.default_rng(0).normal(size=(5, 10)).astype(np.float32)
    normalised = pickle.loads((run / "vecnormalize.pkl").read_bytes()).normalize_obs(observations)
    expected, _ = PPO.load(run / "model.zip", device="cpu").predict(normalised, deterministic=True)
    np.testing.assert_allclose(load_policy(run / POLICY)(observations), expected, atol=AGREEMENT)


def test_training_works_without_fast_ppo(tmp_path):
    root = Path(__file__).parents[3]
    unused = shutil.ignore_patterns("fast_ppo", "checkpoints", "data", "__pycache__", "*.json", "*.npz")
    shutil.copytree(root / "agents", tmp_path / "agents", ignore=unused)
    shutil.copy(root / "train.py", tmp_path)
    words = "--row pareto --num-envs 8 --n-steps 16 --batch-size 64 --total-steps 128 --evaluation-episodes 1"
    command = [sys.executable, "train.py", *words.split(), "--run", "run", "--no-comparison"]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert "agents/fast_ppo is missing: training with Stable-Baselines3's unmodified classes, without " in done.stderr
    assert "--energy-weights (0.1, 20.0)" in done.stderr and "--tanh-mean True" in done.stderr
    assert load_policy(tmp_path / "run" / POLICY).squashing == "clip"
    assert json.loads((tmp_path / "run" / "config.json").read_text())["hyperparameters"]["stock"] is True


def test_a_run_with_wrappers_trains_and_resumes(tmp_path, monkeypatch):
    config = usable(small("direct", "ppo", wrapper=(SWING,), total_steps=384, evaluate_every=256, num_envs=4))
    config = dataclasses.replace(config, evaluation_episodes=1)
    env = make_env(config, 0)
    assert env.observation_space.shape == (2,)
    env.close()
    whole, run = finished(tmp_path / "whole", config), tmp_path / "run"
    begin(run, config)
    train_until(run, 300, monkeypatch, killed=True)
    assert train(run)
    assert differences(run, whole) == []
    assert float(rows(run / "evaluations.csv")[-1]["failed"]) in (0.0, 1.0)
    with pytest.raises(ValueError, match="trained with --wrapper"):
        load_best(run)


WRAPPERS = "tests.agents.training.wrappers"


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nowhere:Nothing", "No module named 'nowhere'"),
        (f"{WRAPPERS}:Missing", "has no attribute 'Missing'"),
        (f"{WRAPPERS}:not_a_wrapper", "--wrapper must be MODULE:ATTRIBUTE of a gymnasium.Wrapper"),
        (f"{WRAPPERS}:np", "--wrapper must be MODULE:ATTRIBUTE of a gymnasium.Wrapper"),
        (f"{WRAPPERS}:TwoArguments", "weight"),
        (f"{WRAPPERS}:Unpicklable", "must be picklable"),
        ("Swing", "--wrapper must be MODULE:ATTRIBUTE"),
    ],
)
def test_a_wrong_wrapper_is_an_error_of_the_command_line(name, reason, tmp_path, capsys):
    words = ["--task", "direct", "--num-envs", "2", "--wrapper", name, "--run", str(tmp_path / "run")]
    assert command_line.main(words) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("train.py: error: ") and "--wrapper" in error and name in error and reason in error
    assert not (tmp_path / "run").exists()


def test_a_wrapper_of_ones_own_is_trusted_before_it_is_resumed(tmp_path, capsys):
    config = usable(small("direct", "ppo", wrapper=("os:abort",)))
    (tmp_path / "config.json").write_text(
        json.dumps({"algo": "ppo", "task": "direct", "hyperparameters": config.to_dict()})
    )
    with pytest.raises(SystemExit):
        command_line.read_args(["--resume", str(tmp_path)])
    assert "('os:abort',): --trust-controller" in capsys.readouterr().err
    args = command_line.read_args(["--resume", str(tmp_path), "--trust-controller"])
    assert args.hyperparameters == config
    with pytest.raises(RunError, match="--wrapper must be MODULE:ATTRIBUTE"):
        make_env(config, 0)


def test_training_has_commands_and_a_limit_of_its_own():
    config = small(
        "direct", "ppo", env="CapsuleVelocity-v0", command_range=(0.15, 0.16), residual_limit=1.0, training_limit=1.2
    )
    venv: Any = make_env(config, 0).venv
    commands = venv.batch.reset(seed=0)[1]["command"]
    assert 0.15 <= commands.min() < commands.max() <= 0.16
    assert venv.batch.simulation.options.residual_limit == 1.2
    assert (config.env_kwargs()["task"], config.env_kwargs()["residual_limit"]) == ("velocity", 1.0)
    with pytest.raises(ValueError, match="command_range must be None in CapsuleGoal-v0"):
        make_env(dataclasses.replace(config, env="CapsuleGoal-v0"), 0)
