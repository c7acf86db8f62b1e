import csv
import dataclasses
import itertools
import json
import shutil
import time

import numpy as np
import pytest
import torch

from agents.criteria import CRITERIA, Criteria
from agents.training.algorithms import make_env, make_model
from agents.training.callbacks import evaluate_wrapped, validation_plants
from agents.training.config import EVALUATIONS, read_config
from agents.training.loop import begin, train
from agents.training.presets import preset
from capsule_gym import load_policy
from capsule_gym.evaluation.episodes import evaluate, scores
from capsule_gym.evaluation.statistics import interquartile_mean
from capsule_gym.parameters import RANDOMIZATIONS
from tests.agents.training.small import (
    SMALL_PPO,
    differences,
    evaluated,
    finished,
    log,
    parameters,
    rows,
    small,
    train_until,
)


def test_bootstrap_happens_at_time_limits_only():
    config = small(
        "direct", "ppo", total_steps=256, episode_seconds=0.4, initial_range=(1.047, 8.0)
    )
    env = make_env(config, 0)
    env.norm_reward = False
    model = make_model(config, env)
    # SB3 adds gamma V(last observation) to the reward if TimeLimit.truncated is set; a large
    # constant V shows where.
    for name, parameter in model.policy.named_parameters():
        if name.startswith("value_net"):
            torch.nn.init.constant_(parameter, 1000.0 if name.endswith("bias") else 0.0)
    model.learn(256)
    # Each environment takes 32 steps, in episodes of 20.
    ended = model.rollout_buffer.episode_starts[1:] == 1.0
    rewards = model.rollout_buffer.rewards[:-1]
    failed = rewards < -0.9 * config.termination_penalty
    truncated = ended & ~failed
    assert truncated.any()
    assert failed.any()
    assert np.array_equal(rewards > 500.0, truncated)


# The last rollout ends at 768 steps.
CONFIG = small(
    "residual",
    "ppo",
    total_steps=700,
    evaluate_every=256,
    evaluation_episodes=8,
    # The law moves the capsule also under an untrained agent.
    total_torque=False,
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run in a new folder, whose first evaluation has the best score."""
    falling = itertools.count(0, -1)
    torch.set_num_threads(2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Criteria, "score", lambda *_: next(falling))
        return finished(tmp_path_factory.mktemp("runs") / "new" / "run", CONFIG)


@pytest.fixture(scope="module")
def content(run):
    return json.loads((run / "config.json").read_text())


def test_a_training_uses_one_thread(run):
    # Sums of several have other bits.
    assert torch.get_num_threads() == 1


def test_the_processor_time_of_a_run_begins_at_zero(tmp_path, monkeypatch):
    monkeypatch.setattr(time, "process_time", lambda: 100.0)
    run = finished(tmp_path / "run", CONFIG)
    lines = csv.DictReader((run / EVALUATIONS).read_text("utf-8").splitlines())
    assert [float(line["core_seconds"]) for line in lines] == [0.0, 0.0, 0.0]


def test_a_folder_that_holds_a_run_is_not_used_again(run):
    with pytest.raises(FileExistsError):
        begin(run, CONFIG)


def test_a_run_records_how_it_was_trained(content):
    assert (content["algo"], content["seed"]) == ("ppo", 0)
    assert content["env"]["controller"] == "baselines:adaptive"
    assert content["revision"]
    assert {"torch", "stable-baselines3", "numpy", "gymnasium"} <= set(content["versions"])


def test_a_run_keeps_its_best_and_its_last_agent(run):
    assert [row["steps"] for row in rows(run / "evaluations.csv")] == ["256", "512", "768"]
    assert parameters(run / "best/model.zip") != parameters(run / "model.zip")


def test_an_evaluation_has_the_interquartile_mean_of_the_speeds(run):
    first, *_ = rows(run / "evaluations.csv")
    speeds = scores(evaluate(load_policy(run), validation_plants(CONFIG)), "mean_speed")
    (value,) = interquartile_mean(speeds)
    # evaluations.csv has four decimals.
    assert float(first["mean_speed_cm_s"]) == round(float(value), 4)
    assert abs(value - speeds.mean()) > 1e-3


def test_a_run_logs_a_table_and_for_tensorboard(run):
    assert log(run)[768]["evaluation/score"]
    assert list((run / "logs").glob("events*"))


def test_the_policy_of_a_run_has_its_settings(run, content):
    policy = load_policy(run)
    assert json.loads(json.dumps(policy.env_kwargs)) == evaluated(content["env"])
    assert (policy.training_seed, policy.revision) == (0, content["revision"])
    assert [bias.size for _, bias in policy.layers] == [CONFIG.hidden, CONFIG.hidden, 1]


def test_other_versions_than_those_of_the_start_are_a_warning(run, content, tmp_path, capsys):
    other = shutil.copytree(run, tmp_path / "run")
    versions = content["versions"] | {"numpy": "1.0"}
    (other / "config.json").write_text(json.dumps(content | {"versions": versions}))
    train(other)
    warnings = capsys.readouterr().err.splitlines()
    change = f"numpy 1.0 is now {content['versions']['numpy']}"
    assert warnings == [f"warning: not the same run to the last bit, since {change}"]


def test_a_run_is_resumed_for_more_steps(run, tmp_path, capsys):
    longer = shutil.copytree(run, tmp_path / "run")
    assert train(longer, 769)
    assert "falls until 769 steps" in capsys.readouterr().out
    assert read_config(longer) == dataclasses.replace(CONFIG, total_steps=769)
    # The step more takes a rollout.
    assert rows(longer / "evaluations.csv")[-1]["steps"] == "1024"


def test_a_complete_run_that_is_resumed_stays_the_same(run, tmp_path, capsys):
    again = shutil.copytree(run, tmp_path / "run")
    for total in (None, 700):
        assert train(again, total)
    assert "falls until" not in capsys.readouterr().out
    assert train(again, 768)
    assert differences(again, run) == []


def test_a_new_run_has_at_least_one_step(tmp_path):
    begin(tmp_path / "run", CONFIG)
    with pytest.raises(ValueError, match=r"^total_steps must be an integer >= 1, the steps"):
        train(tmp_path / "run", 0)


def test_a_run_has_at_least_its_present_steps(run):
    message = r"^total_steps must be an integer >= 768, the steps of the run, got 0$"
    with pytest.raises(ValueError, match=message):
        train(run, 0)


RANGES = {"mass_range": (0.42, 0.44), "friction_range": (0.06, 0.07)}
WRAPPED = {"wrapper": ("tests.agents.training.wrappers:Swing",), "randomization": "real"}
# Environment, column of the main metric, and changes of the preset.
OTHER_TASKS = {
    "goal": ("CapsuleGoal-v0", "goal_time_s", {"static_ratio": 1.5, **RANGES}),
    "wrapped": ("CapsuleGoal-v0", "goal_time_s", WRAPPED | RANGES),
    "velocity": (
        "CapsuleVelocity-v0",
        "velocity_error_percent",
        {"command_range": (0.05, 0.06)},
    ),
}
every_case = pytest.mark.parametrize("case", OTHER_TASKS)
without_wrapper = pytest.mark.parametrize("case", ["goal", "velocity"])


def config_of(case):
    env, _, changes = OTHER_TASKS[case]
    settings = SMALL_PPO | dict(
        n_epochs=1,
        total_steps=768,
        evaluate_every=256,
        episode_seconds=0.4,
    )
    return dataclasses.replace(preset(env, "direct", "ppo"), **settings | changes)


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """A run in each of the other environments."""
    folder = tmp_path_factory.mktemp("others")
    return {case: finished(folder / case, config_of(case)) for case in OTHER_TASKS}


@every_case
def test_a_killed_run_in_another_environment_ends_the_same(tmp_path, monkeypatch, others, case):
    run = tmp_path / "run"
    begin(run, config_of(case))
    train_until(run, 600, monkeypatch, killed=True)
    assert train(run)
    assert differences(run, others[case]) == []


@every_case
def test_a_run_in_another_environment_is_evaluated_by_its_task(others, case):
    _, column, _ = OTHER_TASKS[case]
    last = rows(others[case] / "evaluations.csv")[-1]
    assert {column, f"baseline_{column}", "failed"} < set(last)
    assert float(last[f"baseline_{column}"]) < float(last[column])
    weights = CRITERIA[config_of(case).task].weights
    assert {f"evaluation/{name}" for name in weights} < set(log(others[case])[768])


@every_case
def test_validation_plants_are_of_the_run(case):
    config = config_of(case)
    plants = validation_plants(config)
    least_mass, largest_mass = config.mass_range
    least_friction, largest_friction = config.friction_range
    assert plants.task == config.task
    for plant in plants.plants:
        assert least_mass <= plant.M <= largest_mass
        assert least_friction <= plant.mu <= largest_friction


def test_episodes_that_a_wrapper_ends_have_failed(others):
    assert float(log(others["wrapped"])[768]["episodes/failed"]) > 0.2


def test_the_evaluation_of_a_wrapped_agent_leaves_the_statistics_of_observations():
    config = config_of("wrapped")
    env = make_env(config, 0)
    before = env.obs_rms.count
    evaluate_wrapped(make_model(config, env), config, validation_plants(config))
    assert env.obs_rms.count == before


def test_a_wrapped_run_has_no_policy_file(others):
    with pytest.raises(ValueError, match="name_or_path must be"):
        load_policy(others["wrapped"])


@without_wrapper
def test_a_policy_has_the_plants_of_its_run(others, case):
    config = config_of(case)
    env_kwargs = load_policy(others[case]).env_kwargs
    assert env_kwargs["task"] == config.task
    assert env_kwargs["randomization"].M == config.mass_range
    assert env_kwargs["randomization"].mu == config.friction_range


@pytest.mark.parametrize(
    ("case", "static_ratio", "named"), [("goal", 1.5, True), ("velocity", 1.3, False)]
)
def test_a_policy_has_the_static_ratio_of_its_run(others, case, static_ratio, named):
    capsule = validation_plants(config_of(case)).capsule
    assert capsule.static_ratio == static_ratio
    assert load_policy(others[case]).env_kwargs.get("capsule") == (capsule if named else None)


@without_wrapper
def test_the_best_policy_has_an_evaluated_value(others, case):
    _, column, _ = OTHER_TASKS[case]
    episodes = evaluate(load_policy(others[case]), validation_plants(config_of(case)))
    (value, *_) = interquartile_mean(scores(episodes, column.rpartition("_")[0]))
    evaluated = [float(line[column]) for line in rows(others[case] / "evaluations.csv")]
    assert f"{value:.4f}" in {f"{each:.4f}" for each in evaluated}


def test_model_selection_has_distinct_plants_of_the_training_range():
    plants = validation_plants(small("residual", "ppo")).plants
    low, high = RANDOMIZATIONS["paper"].M
    assert len({plant.M for plant in plants}) == len(plants)
    assert all(low <= plant.M <= high for plant in plants)


def test_model_selection_has_seeds_of_its_own():
    first, second = (validation_plants(small("residual", "ppo", seed=n)).plants for n in (0, 1))
    seeds = {plant.seed for plant in (*first, *second)}
    assert min(seeds) >= 1_000_000
    assert len(seeds) == len(first) + len(second)
