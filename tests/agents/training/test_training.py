"""Training: the SB3 interface, determinism, run folders, interruption and resumption."""

from __future__ import annotations

import csv
import dataclasses
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import SAC

import train as command_line
from agents.comparison import compare
from agents.training.checkpoint import newest
from agents.training.loop import begin, make_env, make_model, own_draws, train
from agents.training.presets import PRESETS, Config
from agents.training.runs import Normalisation, load_policy
from agents.training.sac import LeanSAC
from agents.training.vec_env import CapsuleSB3VecEnv
from capsule_gym import CapsuleVectorEnv
from capsule_gym.parameters import RANDOMIZATIONS

SMALL = {"num_envs": 8, "batch_size": 64, "hidden": 8, "evaluation_episodes": 2, "evaluate_every": 10_000}


def small(task: str, algo: str, **changes) -> Config:
    extra = {"n_steps": 32, "n_epochs": 2} if algo == "ppo" else {"learning_starts": 300, "buffer_size": 2000}
    return dataclasses.replace(PRESETS[task, algo], **{**SMALL, **extra, **changes})


def weights(model) -> np.ndarray:
    return torch.cat([p.detach().flatten() for p in model.policy.parameters()]).numpy()


def test_sb3_batch_is_the_native_batch_with_terminal_observations():
    kwargs = {"controller": "baselines:adaptive", "residual_limit": 3.0, "max_episode_steps": 30}
    ours = CapsuleSB3VecEnv(6, seed=4, **kwargs)
    native = CapsuleVectorEnv(6, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs)
    assert ours.reset().tobytes() == native.reset(seed=4)[0].tobytes()
    rng = np.random.default_rng(0)
    seen = set()
    returns = np.zeros(6)
    for _ in range(100):
        actions = rng.uniform(-1, 1, (6, 1)).astype(np.float32)
        observations, rewards, dones, infos = ours.step(actions)
        expected = native.step(actions)
        assert observations.tobytes() == expected[0].tobytes()
        assert np.array_equal(rewards, expected[1].astype(np.float32))
        assert np.array_equal(dones, expected[2] | expected[3])
        returns += expected[1]
        for i, info in enumerate(infos):
            assert bool(info) == bool(dones[i])
            if dones[i]:
                assert info["terminal_observation"].tobytes() == expected[4]["final_obs"][i].tobytes()
                assert not np.array_equal(info["terminal_observation"], observations[i])
                assert info["TimeLimit.truncated"] == bool(expected[3][i] and not expected[2][i])
                assert info["episode"]["r"] == pytest.approx(returns[i])
                assert info["metrics"]["failed"] == float(expected[2][i])
                returns[i] = 0.0
                seen.add((bool(expected[2][i]), bool(expected[3][i])))
    # Both kinds of end were met: failures and time limits.
    assert {(True, False), (False, True)} <= seen


def test_bootstrap_happens_at_time_limits_only():
    # SB3 adds gamma V(terminal observation) to the reward where TimeLimit.truncated says so: with a critic that says 1
    # everywhere the collected rewards show where.
    config = small("direct", "ppo", total_steps=256)
    env = make_env(config, 0)
    env.venv.batch.max_episode_steps = 20
    model = make_model(config, env)
    for name, parameter in model.policy.named_parameters():
        if name.startswith("value_net"):
            torch.nn.init.constant_(parameter, 1000.0 if name.endswith("bias") else 0.0)
    model.learn(256)
    rewards = model.rollout_buffer.rewards
    assert np.count_nonzero(rewards > 500.0) == 8
    env.close()


def test_interface_of_the_vec_env():
    env = CapsuleSB3VecEnv(3, controller="baselines:adaptive", render_mode="rgb_array")
    env.seed(3)
    env.reset()
    assert env.get_attr("max_episode_steps") == [1650] * 3
    assert env.get_attr("render_mode", [0]) == ["rgb_array"]
    assert [set(m) >= {"mean_speed"} for m in env.env_method("episode_metrics")] == [True] * 3
    assert env.env_is_wrapped(type(None)) == [False] * 3
    with pytest.raises(AttributeError, match="share their settings"):
        env.set_attr("render_mode", None)
    assert len(env.get_images()) == 3
    env.close()


@pytest.mark.parametrize(("task", "algo"), list(PRESETS))
def test_same_seed_same_model_another_seed_another(tmp_path, task, algo):
    models = []
    for n, seed in enumerate((0, 0, 1)):
        run = tmp_path / str(n)
        config = small(task, algo, total_steps=512, seed=seed)
        begin(run, config)
        assert train(run, config)
        models.append(weights(load_policy(run / "model.zip").model))
    assert np.array_equal(models[0], models[1])
    assert not np.array_equal(models[0], models[2])


def test_a_run_folder_holds_what_a_policy_needs(tmp_path):
    run = tmp_path / "run"
    config = small("residual", "ppo", total_steps=512, evaluate_every=256)
    begin(run, config)
    with pytest.raises(FileExistsError):
        begin(run, config)
    assert train(run, config)
    content = json.loads((run / "config.json").read_text())
    assert content["algo"] == "ppo" and content["seed"] == 0
    assert content["env"]["controller"] == "baselines:adaptive"
    assert {"torch", "stable-baselines3", "numpy", "numba", "gymnasium"} <= set(content["versions"])
    assert content["revision"]
    with (run / "evaluations.csv").open() as file:
        steps = [int(row["steps"]) for row in csv.DictReader(file)]
    assert steps == [256, 512]
    assert (run / "logs" / "progress.csv").stat().st_size > 0
    assert list((run / "logs").glob("events*"))
    assert len(list(run.glob("checkpoint-*"))) == 2

    policy = load_policy(run)
    observations = np.random.default_rng(0).normal(size=(5, 10)).astype(np.float32)
    normalised = Normalisation.read(run / "best" / "normalisation.json")(observations)
    expected, _ = policy.model.predict(normalised, deterministic=True)
    assert np.array_equal(policy.start([0] * 5)(observations), expected)
    (run / "best" / "normalisation.json").unlink()
    with pytest.raises(ValueError, match=r"normalisation\.json is missing"):
        load_policy(run)


def test_saved_normalisation_is_the_one_that_sb3_applies(tmp_path):
    env = make_env(small("direct", "ppo"), 0)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(50):
        env.step(rng.uniform(-1, 1, (8, 1)).astype(np.float32))
    Normalisation.of(env).write(tmp_path / "n.json")
    raw = env.get_original_obs()
    np.testing.assert_allclose(Normalisation.read(tmp_path / "n.json")(raw), env.normalize_obs(raw), rtol=1e-6)
    env.close()


def test_model_selection_uses_draws_of_its_own():
    draws = own_draws(small("residual", "ppo"))
    assert min(plant.seed for plant in draws.plants) >= 1_000_000
    low, high = RANDOMIZATIONS["paper"].M
    assert all(low <= plant.M <= high for plant in draws.plants)
    assert len({plant.M for plant in draws.plants}) == len(draws.plants)
    assert own_draws(small("residual", "ppo", seed=1)).plants[0].seed not in {p.seed for p in draws.plants}


def test_comparison_is_printed_and_drawn(tmp_path, capsys, monkeypatch):
    run = tmp_path / "run"
    config = small("residual", "ppo", total_steps=256)
    begin(run, config)
    train(run, config)
    set_file = tmp_path / "two.json"
    plants = [{"M": 0.5, "mu": 0.01, "seed": 0, "changes": []}, {"M": 0.52, "mu": 0.01, "seed": 1, "changes": []}]
    set_file.write_text(json.dumps({"name": "two", "plants": plants}))
    monkeypatch.setattr("agents.comparison.ANIMATED_STEPS", 4)
    monkeypatch.setattr("agents.comparison.ANIMATED_FROM", 2)
    compare(run, str(set_file))
    out = capsys.readouterr().out
    for word in ("mean speed", "cost of transport", "peak torque", "backward", "failures", "difference", "adaptive"):
        assert word in out
    for name in ("comparison.png", "animation.gif", "comparison.json"):
        assert (run / name).stat().st_size > 1000
    assert not list(run.glob("*.tmp*"))


def _train_process(*arguments: str) -> subprocess.Popen:
    command = [sys.executable, "train.py", "--no-comparison", *arguments]
    return subprocess.Popen(command, cwd=Path(__file__).parents[3], stderr=subprocess.PIPE, text=True)


def _wait_for(condition, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_kill_and_interrupt_lose_nothing_that_resume_cannot_find(tmp_path):
    run = tmp_path / "run"
    options = ("--total-steps", "10_000_000", "--num-envs", "8", "--n-steps", "32", "--batch-size", "64")
    options += ("--evaluate-every", "1000", "--evaluation-episodes", "1")
    process = _train_process("--run", str(run), *options)
    _wait_for(lambda: newest(run), process)
    process.kill()
    process.communicate()
    first = newest(run)
    assert first is not None

    process = _train_process("--resume", str(run))
    _wait_for(lambda: newest(run) != first, process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    second = newest(run)
    assert second is not None and second.name > first.name
    assert (run / "model.zip").is_file()

    steps = int(second.name.split("-")[1])
    assert command_line.main(["--resume", str(run), "--total-steps", str(steps + 500), "--no-comparison"]) == 0
    third = newest(run)
    assert third is not None and int(third.name.split("-")[1]) >= steps + 500
    progress = json.loads((third / "progress.json").read_text())
    assert progress["resumed_at"] == [int(first.name.split("-")[1]), steps]
    # One log for all parts, in which each step stands once.
    with (run / "logs" / "progress.csv").open() as file:
        logged = [int(row["time/total_timesteps"]) for row in csv.DictReader(file)]
    assert logged == sorted(set(logged)) and logged[0] < int(first.name.split("-")[1]) < logged[-1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "sideways"], "--task"),
        (["--algo", "dqn"], "--algo"),
        (["--total-steps", "many"], "--total-steps"),
        (["--randomization", "huge"], "--randomization"),
        (["--n-steps", "-4"], "--n-steps"),
        (["--observe-parameters", "perhaps"], "--observe-parameters"),
        (["--resume", "nowhere"], "nowhere"),
    ],
)
def test_bad_options_are_named(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        command_line.main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_a_run_is_never_overwritten(tmp_path, capsys):
    assert command_line.main(["--run", str(tmp_path)]) == 2
    assert "--resume" in capsys.readouterr().err


def test_lean_sac_makes_the_updates_of_sb3():
    results = []
    for kind in (SAC, LeanSAC):
        config = small("residual", "sac", learning_starts=400)
        env = make_env(config, 0)
        model = make_model(config, env, sac=kind, fused=False)
        # Too few steps for an update: both hold the same transitions and the same networks.
        model.learn(400)
        np.random.seed(0)
        torch.manual_seed(0)
        before = weights(model)
        for _ in range(10):
            model.train(1, 64)
        entropy = model.log_ent_coef.item()
        losses = {name: value for name, value in model.logger.name_to_value.items() if name.startswith("train/")}
        results.append((weights(model), entropy, losses))
        assert not np.array_equal(before, results[-1][0])
        env.close()
    (expected, entropy, losses), (found, own_entropy, own_losses) = results
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    assert own_entropy == pytest.approx(entropy, rel=1e-5)
    assert own_losses == pytest.approx(losses, rel=1e-3, abs=1e-6)


def test_lean_sac_draws_a_batch_of_its_own_for_each_update(monkeypatch):
    config = small("residual", "sac", learning_starts=400)
    env = make_env(config, 0)
    model = make_model(config, env)
    model.learn(400)
    sizes, batches = [], []
    draw = model.replay_buffer.sample
    monkeypatch.setattr(model.replay_buffer, "sample", lambda size, env: sizes.append(size) or draw(size, env=env))
    sample = LeanSAC.train.__globals__["sample"]
    monkeypatch.setattr(
        "agents.training.sac.sample", lambda actor, seen: batches.append(seen.numpy()) or sample(actor, seen)
    )
    model.train(3, 16)
    assert sizes == [48]
    assert [batch.shape for batch in batches] == [(16, 10)] * 6
    assert len({batch.tobytes() for batch in batches}) == 6
    env.close()
