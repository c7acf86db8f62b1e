"""The hyperparameters of training: options shared with the environment have its descriptions and defaults."""

import dataclasses
import math
import re

import pytest

import train
from agents.analysis.statistics import read_evaluations
from agents.distillation.config import STUDENTS
from agents.training.config import EVALUATIONS, RANGES
from agents.training.presets import PRESETS, ROWS
from baselines.evaluation.policies import CHECKPOINTS, checkpoint_names, find_candidate


@pytest.mark.parametrize("name", RANGES)
def test_a_range_ends_where_its_words_say(name):
    words, low, high, _ = RANGES[name]
    config = next(each for each in PRESETS.values() if hasattr(each, name))
    for end, refused in ((low, ">= " not in words and "[" not in words), (high, not math.isfinite(high))):
        changed = dataclasses.replace(config, **{name: end})
        if refused:
            with pytest.raises(ValueError, match=f"^{name} must be {re.escape(words)}, got"):
                changed.check()
        else:
            changed.check()


@pytest.mark.parametrize("name", ROWS)
def test_a_committed_policy_acts_as_its_rows_settings_say(name):
    settings = ROWS[name]
    settings.check()
    assert settings.seed == 0
    for policy in find_candidate(name).policies:
        # The plants, the observation and the law of a row stay; these settings may change with its training.
        changing = {"initial_range", "termination_penalty", "control_dt", "total_torque"}
        found, expected = (
            {name: value for name, value in kwargs.items() if name not in changing}
            for kwargs in (policy.env_kwargs, settings.env_kwargs())
        )
        assert found == expected
        assert policy.algorithm == settings.algo
        assert [bias.size for _, bias in policy.layers] == [settings.hidden, settings.hidden, 1]


@pytest.mark.parametrize("name", sorted(ROWS))
def test_committed_evaluations_are_those_of_the_rows_settings(name):
    config = ROWS[name]
    steps, _ = read_evaluations(CHECKPOINTS / name / "seed-0" / EVALUATIONS, config.env_task)
    rollout = config.num_envs * (config.n_steps if config.algo == "ppo" else 1)
    expected = [math.ceil(each / rollout) * rollout for each in (config.evaluate_every, config.total_steps)]
    assert steps[[0, -1]].tolist() == expected


def test_the_table_of_commands_names_every_row_and_its_seeds():
    page = (CHECKPOINTS / "README.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| `([\w-]+)` \| (\d+)(?: to (\d+))? \| `python (.*)` \|$", page, re.MULTILINE)
    assert sorted(name for name, *_ in lines) == checkpoint_names()
    for name, first, last, command in lines:
        seeds = [run.training_seed for run in find_candidate(name).policies]
        assert seeds == list(range(int(first), int(last or first) + 1))
        if name in STUDENTS:
            assert command == f"-m agents.distillation {name} --seeds N"
            continue
        program, *words = command.replace(" N", " 7").split()
        assert program == "train.py"
        assert train.read_args(words).hyperparameters == dataclasses.replace(ROWS[name], seed=7)
