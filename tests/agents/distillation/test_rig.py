"""Students of an identified rig."""

import dataclasses

import numpy as np
import pytest

from agents.distillation import dagger, dataset
from agents.distillation.__main__ import main
from agents.distillation.config import RIG, STUDENTS, for_rig
from agents.distillation.plants import draw_changes, draw_disturbances, draw_groups
from capsule_gym import CapsuleVectorEnv, load_policy
from tests.agents.distillation.conftest import RECURRENT
from tests.agents.rig import RANGES, make_fit

STUDENT = for_rig(dataclasses.replace(RECURRENT, groups=2, final_updates=2), make_fit())


def within(name, value):
    low, high = RANGES[name]
    return low <= value <= high


def test_plants_are_those_of_the_rig():
    groups = draw_groups(dataclasses.replace(STUDENT, groups=20))
    problems = [problem for group in groups for problem in group.problems]
    for name in ("M", "mu", "l", "motor_friction"):
        values = [getattr(problem, name) for problem in problems]
        assert len(set(values)) == len(values)
        assert all(within(name, value) for value in values)
    assert {problem.m for problem in problems} == {0.15}
    assert {problem.static_ratio for problem in problems} == {1.0}


@pytest.mark.parametrize("name", STUDENTS)
def test_the_plants_of_a_rig_do_not_change(name):
    student = for_rig(dataclasses.replace(STUDENTS[name], groups=1), make_fit())
    (group,) = draw_groups(student)
    assert draw_changes(group, student.change_rate, 16.0, np.random.default_rng(0)) == []
    assert student.spare_share == 0.0


def test_policies_are_selected_on_plants_of_the_rig():
    (selection,) = dagger._validation_plants(STUDENT, 0)
    assert len(selection.plants) == STUDENT.evaluation_episodes
    for plant in selection.plants:
        assert within("M", plant.M)
        assert within("mu", plant.mu)


def test_disturbances_are_those_of_the_rig():
    rng = np.random.default_rng(0)
    (group, *_) = draw_groups(STUDENT)
    drawn = draw_disturbances(group, rng)
    assert within("latency", drawn["latency"])
    assert drawn["lag"] == 0.004
    assert drawn["theta_noise"] == 0.0
    assert drawn["motor_friction"] == group.problems[0].motor_friction


def test_friction_acts_once():
    groups = draw_groups(STUDENT)
    options = dataset._episode_options(STUDENT, groups, np.random.default_rng(0))
    env = CapsuleVectorEnv(STUDENT.num_envs, **STUDENT.env_kwargs)
    _, info = env.reset(seed=0, options=options)
    friction = info["capsule"]["motor_friction"] + info["disturbances"]["motor_friction"]
    assert {*friction.tolist()} <= {group.problems[0].motor_friction for group in groups}


def test_the_command_distils_a_policy_of_the_rig(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(STUDENTS, "dp-distilled", dataclasses.replace(RECURRENT, groups=2))
    fit = make_fit()
    fit.save(tmp_path / "mine.json")
    words = ["--rig", str(tmp_path / "mine.json"), "--seeds", "3", "--runs", str(tmp_path)]
    assert main(["dp-distilled", *words]) == 0
    run = tmp_path / "dp-distilled-mine" / "seed-3"
    printed = capsys.readouterr().out
    assert f"python -m agents.evaluate {run.parent} --against" in printed
    assert f"python -m capsule_gym.export {run} --c policy.h" in printed
    env_kwargs = load_policy(run).env_kwargs
    for name, value in fit.env_kwargs().items():
        assert env_kwargs[name] == value
    assert STUDENT.plants == {RIG: 1}


def test_a_missing_file_is_an_error(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["dp-distilled", "--rig", str(tmp_path / "no.json"), "--runs", str(tmp_path)])
    assert "no.json" in capsys.readouterr().err
