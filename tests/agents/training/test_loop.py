import dataclasses
import itertools
import json

import numpy as np
import pytest
import torch

from agents.criteria import CRITERIA
from agents.training.algorithms import make_env, make_model
from agents.training.callbacks import validation_plants
from agents.training.config import read_config
from agents.training.loop import begin, train
from agents.training.presets import preset
from capsule_gym import load_policy
from capsule_gym.evaluation.episodes import evaluate, scores
from capsule_gym.evaluation.statistics import interquartile_mean
from capsule_gym.parameters import RANDOMIZATIONS
from tests.agents.training.small import (
    SMALL,
    differences,
    finished,
    log,
    parameters,
    rows,
    small,
    train_until,
)


def test_bootstrap_happens_at_time_limits_only():
    # SB3 adds gamma V(last observation) to the reward if TimeLimit.truncated is set; a large
    # constant V shows where.
    config = small(
        "direct", "ppo", total_steps=256, episode_seconds=0.4, initial_range=(1.047, 8.0)
    )
    env = make_env(config, 0)
    env.norm_reward = False
    model = make_model(config, env)
    for name, parameter in model.policy.named_parameters():
        if name.startswith("value_net"):
            torch.nn.init.constant_(parameter, 1000.0 if name.endswith("bias") else 0.0)
    model.learn(256)
    buffer = model.rollout_buffer
    # Each environment takes 32 steps, in episodes of 20.
    ended, rewards = buffer.episode_starts[1:] == 1.0, buffer.rewards[:-1]
    failed = rewards < -0.9 * config.termination_penalty
    assert (
        (ended & ~failed).any()
        and failed.any()
        and np.array_equal(rewards > 500.0, ended & ~failed)
    )


def test_a_run_folder_holds_what_a_policy_needs(tmp_path, capsys, monkeypatch):
    falling = itertools.count(0, -1)
    monkeypatch.setattr(type(CRITERIA["speed"]), "score", lambda *_: next(falling))
    run = tmp_path / "run"
    config = small("residual", "ppo", total_steps=768, evaluate_every=256)
    torch.set_num_threads(2)
    finished(run, config)
    assert torch.get_num_threads() == 1  # sums of several have other bits
    with pytest.raises(FileExistsError):
        begin(run, config)
    content = json.loads((run / "config.json").read_text())
    named = content["algo"], content["seed"], content["env"]["controller"]
    assert named == ("ppo", 0, "baselines:adaptive") and content["revision"]
    assert {"torch", "stable-baselines3", "numpy", "gymnasium"} <= set(content["versions"])
    steps = [int(row["steps"]) for row in rows(run / "evaluations.csv")]
    assert steps == [256, 512, 768] and parameters(run / "best/model.zip") != parameters(
        run / "model.zip"
    )
    assert log(run)[768]["evaluation/score"] and list((run / "logs").glob("events*"))
    policy = load_policy(run)
    assert json.loads(json.dumps(policy.env_kwargs)) == content["env"]
    assert (policy.training_seed, policy.revision) == (0, content["revision"])
    assert train(run, 1024) and "falls until 1,024 steps" in capsys.readouterr().out
    assert read_config(run) == dataclasses.replace(config, total_steps=1024)
    with pytest.raises(
        ValueError, match=r"^total_steps must be an integer >= 1024, the steps of the run, got 0$"
    ):
        train(run, 0)


RANGES = {"mass_range": (0.42, 0.44), "friction_range": (0.06, 0.07)}
WRAPPED = {"wrapper": ("tests.agents.training.wrappers:Swing",), "randomization": "real", **RANGES}
JUDGED = [
    ("CapsuleGoal-v0", "goal_time_s", changes)
    for changes in ({"static_ratio": 1.5, **RANGES}, WRAPPED)
]
JUDGED += [("CapsuleVelocity-v0", "velocity_error_percent", {"command_range": (0.05, 0.06)})]


@pytest.mark.parametrize(("env", "column", "changes"), JUDGED)
def test_a_run_in_another_environment_is_judged_by_its_task(
    tmp_path, monkeypatch, env, column, changes
):
    settings = {
        **SMALL,
        "n_steps": 32,
        "n_epochs": 1,
        "total_steps": 768,
        "evaluate_every": 256,
        **changes,
    }
    config = dataclasses.replace(preset(env, "direct", "ppo"), episode_seconds=0.4, **settings)
    run, whole, task = tmp_path / "run", finished(tmp_path / "whole", config), config.task
    begin(run, config)
    train_until(run, 600, monkeypatch, killed=True)
    assert train(run) and differences(run, whole) == []
    lines = rows(run / "evaluations.csv")
    assert {column, f"baseline_{column}", "failed"} < set(lines[-1])
    assert float(lines[-1][f"baseline_{column}"]) < float(lines[-1][column])
    assert {f"evaluation/{name}" for name in CRITERIA[task].weights} < set(log(run)[768])
    plants = validation_plants(config)
    assert plants.task == task and min(plant.mu for plant in plants.plants) >= 0.05
    if config.wrapper:
        assert float(log(run)[768]["episodes/failed"]) > 0.2  # by the wrapper
        with pytest.raises(ValueError, match="name_or_path must be"):
            load_policy(run)
        return
    policy = load_policy(run)
    assert policy.env_kwargs["task"] == task
    if (M := config.mass_range) and (mu := config.friction_range):
        assert all(
            M[0] <= plant.M <= M[1] and mu[0] <= plant.mu <= mu[1] for plant in plants.plants
        )
        assert (policy.env_kwargs["randomization"].M, policy.env_kwargs["randomization"].mu) == (
            M,
            mu,
        )
    expected = (1.5, plants.capsule) if config.static_ratio else (1.3, None)
    assert (plants.capsule.static_ratio, policy.env_kwargs.get("capsule")) == expected
    values = scores(evaluate(policy, plants), column.rpartition("_")[0])
    assert f"{interquartile_mean(values)[0]:.4f}" in {
        f"{float(line[column]):.4f}" for line in lines
    }


def test_model_selection_uses_draws_of_its_own():
    draws = validation_plants(small("residual", "ppo")).plants
    masses, (low, high) = {plant.M for plant in draws}, RANDOMIZATIONS["paper"].M
    assert min(plant.seed for plant in draws) >= 1_000_000 and len(masses) == len(draws)
    assert all(low <= M <= high for M in masses)
    assert validation_plants(small("residual", "ppo", seed=1)).plants[0].seed not in {
        p.seed for p in draws
    }
