"""The study of authority: what is trained, what is kept of it, and what is shown."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from agents.authority import __main__ as command
from agents.authority.design import (
    BASES,
    DIRECT,
    EPISODES,
    FIRST_SEED,
    LIMITS,
    RECIPES,
    Arm,
    all_arms,
    direct,
    own_plants,
    plan,
)
from agents.authority.page import render
from agents.authority.results import Results, Run, gather, judge, laws_alone, load, save
from agents.training.errors import RunError
from agents.training.loop import SELECTION_SEED, own_draws
from agents.training.presets import ROWS
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.task import TORQUE_LIMIT

STEPS = 1_000_000
# Of a training that has an update.
SHORT = 163_840
ON_A_LAW = ("task", "controller", "residual_limit")
ON_GAIT = Arm("gait-guarded", "paper", 0.75, "cautious")


def made(arms, seeds=(0, 1, 2)) -> Results:
    """Results that are known: an agent adds its limit to the speed of its law, and its seed to that; its last fails."""
    alone = dict.fromkeys(arm.alone for arm in arms if arm.base)
    speeds = {arm: tuple(10.0 + 0.01 * n for n in range(8)) for arm in alone}
    runs = [Run(arm, None, speeds[arm], ()) for arm in alone]
    for arm in arms:
        for seed in seeds:
            own = tuple(10.0 + 0.01 * n + arm.limit + seed for n in range(8))
            runs.append(Run(arm, seed, own, (7,), ((STEPS // 2, 5.0, 0.5), (STEPS, 9.0, 0.0)), "abc"))
    return Results(STEPS, tuple(runs), {"sets": {}, "versions": {}})


def test_kinds_differ_in_law_limit_plants_and_recipe_alone():
    arms = all_arms()
    assert len(set(arms)) == len(arms) == len({arm.name for arm in arms})
    for arm in arms:
        config = arm.config(3, STEPS)
        config.check()
        assert (config.seed, config.total_steps, config.randomization) == (3, STEPS, arm.plants)
        row = ROWS[RECIPES[arm.recipe] if arm.recipe else DIRECT[arm.plants]]
        changed = {
            each.name for each in dataclasses.fields(row) if getattr(row, each.name) != getattr(config, each.name)
        }
        assert changed <= {"seed", "total_steps", "evaluate_every", "randomization", *ON_A_LAW}
        if arm.base:
            assert config.env_kwargs()["residual_limit"] == arm.limit
            assert config.controller.startswith("baselines:")
        else:
            assert config.task == "direct" and arm.limit == TORQUE_LIMIT


def test_all_that_is_compared_has_the_same_limits():
    assert LIMITS[-1] == 2.0 * TORQUE_LIMIT
    for base, (_, examined) in BASES.items():
        for plants in examined:
            for recipe in RECIPES:
                found = [
                    arm.limit for arm in all_arms() if (arm.base, arm.plants, arm.recipe) == (base, plants, recipe)
                ]
                assert found == list(LIMITS)


@pytest.mark.parametrize("plants", list(DIRECT))
def test_the_plants_of_the_judgement_are_nobody_elses(plants):
    drawn = own_plants(plants)
    seeds = {plant.seed for plant in drawn.plants}
    assert len(seeds) == len(drawn.plants) == EPISODES
    config = dataclasses.replace(ROWS["direct-ppo"], randomization=plants, seed=1000)
    assert min(seeds) == FIRST_SEED > SELECTION_SEED + 1000 * config.evaluation_episodes
    others = [*own_draws(config).plants, *(plant for name in SET_NAMES for plant in load_set(name).plants)]
    assert not {(plant.M, plant.mu) for plant in drawn.plants} & {(plant.M, plant.mu) for plant in others}


def test_first_seeds_come_first_and_other_settings_are_refused(tmp_path):
    arms = [ON_GAIT, direct("wide")]
    jobs = plan(arms, [0, 1], STEPS, tmp_path)
    assert [job.name for job in jobs] == [f"{arm.name}/seed-{seed}" for seed in (0, 1) for arm in arms]
    assert list(jobs.values()) == arms * 2
    run = tmp_path / ON_GAIT.name / "seed-0"
    run.mkdir(parents=True)
    content = {"task": "residual", "algo": "ppo", "hyperparameters": ON_GAIT.config(0, 2 * STEPS).to_dict()}
    (run / "config.json").write_text(json.dumps(content))
    with pytest.raises(RunError, match="total_steps was 2000000 and is 1000000"):
        plan(arms, [0], STEPS, tmp_path)


def test_results_come_back_as_they_were(tmp_path):
    arms = [ON_GAIT, direct("paper")]
    results = gather(made(arms).runs, STEPS)
    save(results, tmp_path / "results.json")
    assert load(tmp_path / "results.json") == results
    text = (tmp_path / "results.json").read_text()
    assert len(text.splitlines()) == len(results.runs) + 2

    changed = json.loads(text)
    changed["sets"]["paper"] = "0"
    (tmp_path / "results.json").write_text(json.dumps(changed))
    with pytest.raises(ValueError, match="episodes on other plants of paper"):
        load(tmp_path / "results.json")
    (tmp_path / "results.json").write_text("{}")
    with pytest.raises(ValueError, match="--publish` writes, got KeyError: 'runs'"):
        load(tmp_path / "results.json")


def test_agents_are_compared_with_their_law_on_the_same_plants():
    results = made([ON_GAIT, direct("paper")])
    assert results.speeds(ON_GAIT).shape == (3, 8)
    assert results.failed(ON_GAIT).sum(axis=0).tolist() == [0.0] * 7 + [3.0]
    text = render(results)
    (line,) = [line for line in text.splitlines() if line.startswith("| gait") and "0.75" in line and "/" in line]
    # Every seed is faster by its limit and its number, on every plant.
    assert "+1.75 [+0.75, +2.75]" in line and "3/24" in line
    assert "6 trainings of 1,000,000 steps, training seeds 0, 1, 2; 8 plants" in text
    assert "| none (direct) | paper" in text and "[start:learning]" in text


@pytest.mark.parametrize("arms", [all_arms(), all_arms()[:3]], ids=["whole", "part"])
def test_figure(arms, tmp_path):
    (tmp_path / "figures").mkdir()
    command.write_docs(made(arms), tmp_path)
    with Image.open(tmp_path / "figures" / "authority.png") as picture:
        assert picture.width == 1400
    assert (tmp_path / command.TABLES).read_text() == render(made(arms))


def test_a_law_alone_is_judged_once_per_plants():
    (run,) = laws_alone([ON_GAIT, dataclasses.replace(ON_GAIT, limit=0.3), direct("paper")])
    assert (run.arm, run.seed) == (ON_GAIT.alone, None)
    assert len(run.speeds) == EPISODES and min(run.speeds) > 15.0 and not run.failed


def test_the_command_trains_judges_and_publishes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "all_arms", lambda: [ON_GAIT])
    (tmp_path / "docs" / "figures").mkdir(parents=True)
    (tmp_path / "agents" / "authority").mkdir(parents=True)
    words = ["--seeds", "0", "--total-steps", str(SHORT), "--jobs", "1", "--runs", str(tmp_path / "runs"), "--publish"]
    assert command.main(words, root=tmp_path) == 0
    assert f"1 trainings of {SHORT:,} steps" in capsys.readouterr().out
    results = load(tmp_path / "agents" / "authority" / "results.json")
    assert results.arms() == [ON_GAIT.alone, ON_GAIT]
    # What is finished is judged again, to the same numbers.
    (job,) = plan([ON_GAIT], [0], SHORT, tmp_path / "runs")
    assert judge(job, ON_GAIT) == results.of(ON_GAIT)[0]
    # An agent that has hardly learnt anything yet does what its law does, nearly.
    assert np.abs(results.speeds(ON_GAIT) - results.speeds(ON_GAIT.alone)).max() < 1.0
    assert (tmp_path / "docs" / command.TABLES).is_file()


def test_the_page_shows_the_committed_results():
    assert (command.ROOT / command.DOCS / command.TABLES).read_text(encoding="utf-8") == render(load())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--total-steps", "0"], "--total-steps must be an integer >= 1, got 0"),
        (["--seeds", "x"], "--seeds must be integers and ranges"),
        (["--jobs", "0"], "--jobs must be an integer >= 1, got 0"),
    ],
)
def test_wrong_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(words)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
