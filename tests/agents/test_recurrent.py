"""Evaluation, leaderboard and analysis keep the memory of a recurrent policy."""

import json
import shutil

import numpy as np
import pytest

from agents import evaluate as command
from agents.analysis import limit_cycle, sensitivity
from agents.leaderboard.rows import evaluate, load_row, save_row
from capsule_gym import CapsuleEnv, load_policy
from capsule_gym.evaluation import candidates
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import evaluate as evaluate_policy
from capsule_gym.files import to_json
from capsule_gym.policies.policy import POLICY
from tests.capsule_gym.policies.test_recurrent import TRAINED
from tests.capsule_gym.policies.test_recurrent_use import (
    PLANTS,
    SECONDS,
    STEPS,
    distances,
    played,
)


@pytest.fixture
def policy():
    return load_policy(TRAINED)


def test_the_command_evaluates_a_file(policy, tmp_path, capsys):
    plants = tmp_path / "three.json"
    plants.write_text(to_json(PLANTS.to_dict()))
    out = tmp_path / "result.json"
    words = ["--set", str(plants), "--against", "direct-ppo/seed-0", "--json", str(out)]
    assert command.main([str(TRAINED), *words]) == 0
    assert "0/3" in capsys.readouterr().out
    found = json.loads(out.read_text())["episodes"]
    assert distances(found) == distances(evaluate_policy(policy, PLANTS))


def test_a_row_of_the_leaderboard_holds_its_episodes(policy, tmp_path, monkeypatch):
    monkeypatch.setattr(candidates, "CHECKPOINTS", tmp_path)
    run = tmp_path / "recurrent" / "seed-0"
    run.mkdir(parents=True)
    shutil.copy(TRAINED, run / POLICY)
    (row,) = evaluate([find_candidate("recurrent")], [PLANTS], horizon=SECONDS)
    save_row(tmp_path / "results", row)
    found = load_row(tmp_path / "results" / "recurrent.npz")
    assert found.header["description"].startswith("Recurrent PPO, ")
    assert list(found.header["files"]) == [f"seed-0/{POLICY}"]
    expected = [played(policy, plant).episode_metrics(STEPS) for plant in PLANTS.plants]
    for name in ("mean_speed", "cost_of_transport", "peak_torque"):
        values = [metrics[name] for metrics in expected]
        assert found.score("three", name).tolist() == [values]


def test_the_sensitivity_is_that_of_its_episodes(policy, monkeypatch):
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    name = str(TRAINED)
    found = sensitivity.run([find_candidate(name)], horizon=1.0)[name]

    class InPython:
        name = "loop"
        env_kwargs = policy.env_kwargs
        start = policy.start

    looped = candidates.Candidate("loop", (InPython(),), "")
    assert found == sensitivity.run([looped], horizon=1.0)["loop"]


def test_samples_of_a_limit_cycle_are_those_of_the_episode(policy, monkeypatch):
    monkeypatch.setattr(limit_cycle, "HORIZON", SECONDS)
    samples = limit_cycle.sample_episode(policy)
    env = CapsuleEnv(**(policy.env_kwargs | {"randomization": "none"}))
    observation, _ = env.reset(seed=0)
    act = policy.start([0])
    found = []
    for _ in range(STEPS):
        observation, _, _, _, info = env.step(act(observation))
        found.append(info["state"])
    interval = len(samples) // STEPS
    np.testing.assert_allclose(samples[interval - 1 :: interval, :4], found, rtol=0.0, atol=1e-9)


def test_a_policy_has_a_limit_cycle(policy):
    cycle = limit_cycle.find_cycle(limit_cycle.sample_episode(policy))
    assert cycle[-1, limit_cycle.X] > cycle[0, limit_cycle.X]
