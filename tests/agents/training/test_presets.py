"""The hyperparameters of training: options shared with the environment have its descriptions and
defaults."""

import dataclasses
import json
import math
import re
from contextlib import nullcontext

import pytest

import train
from agents.analysis.curves import read_evaluations
from agents.distillation.config import STUDENTS
from agents.distillation.dagger import CLIP, EPSILON, HIDDEN, MIN_VARIANCE
from agents.training.config import CONFIG, EVALUATIONS, RANGES, read_config
from agents.training.presets import PRESETS, TRAINED_ROWS
from capsule_gym.evaluation.candidates import CHECKPOINTS, checkpoint_names, find_candidate
from capsule_gym.files import to_json
from capsule_gym.policies.policy import IMITATION


@pytest.mark.parametrize("name", RANGES)
def test_a_range_ends_where_its_words_say(name):
    words, low, high, _ = RANGES[name]
    config = next(each for each in PRESETS.values() if hasattr(each, name))
    for end, refused in (
        (low, ">= " not in words and "[" not in words),
        (high, not math.isfinite(high)),
    ):
        changed = dataclasses.replace(config, **{name: end})
        with (
            pytest.raises(ValueError, match=f"^{name} must be {re.escape(words)}, got")
            if refused
            else nullcontext()
        ):
            changed.check()


@pytest.mark.parametrize("name", [*TRAINED_ROWS, *STUDENTS])
def test_a_rows_settings_are_those_that_its_policies_were_trained_with(name):
    record, policies = (
        json.loads((CHECKPOINTS / name / CONFIG).read_text("utf-8")),
        find_candidate(name).policies,
    )
    if name in STUDENTS:
        assert record["hyperparameters"] == json.loads(to_json(dataclasses.asdict(STUDENTS[name])))
        expected = STUDENTS[name].env_kwargs, IMITATION, HIDDEN
        assert all((CLIP, EPSILON) == (each.clip, each.epsilon) for each in policies)
        assert (
            min(each.variance.min() for each in find_candidate("dp-distilled-wide").policies)
            == MIN_VARIANCE
        )
    else:
        settings = TRAINED_ROWS[name]
        assert dataclasses.replace(read_config(CHECKPOINTS / name), seed=0) == settings
        expected = settings.env_kwargs(), settings.algo, settings.hidden
        rollout = settings.num_envs * (settings.n_steps if settings.algo == "ppo" else 1)
        ends = [
            math.ceil(each / rollout) * rollout
            for each in (settings.evaluate_every, settings.total_steps)
        ]
        for path in (CHECKPOINTS / name).glob(f"*/{EVALUATIONS}"):
            assert read_evaluations(path, settings.task)[0][[0, -1]].tolist() == ends
    for policy in policies:
        assert (policy.env_kwargs, policy.algorithm) == expected[:2] and policy.revision == record[
            "revision"
        ]
        assert [bias.size for _, bias in policy.layers] == [expected[2], expected[2], 1]


def test_the_table_of_commands_names_every_row_and_its_seeds():
    page = (CHECKPOINTS / "README.md").read_text(encoding="utf-8")
    lines = re.findall(
        r"^\| `([\w-]+)` \| (\d+)(?: to (\d+))? \| `python (.*)` \|$", page, re.MULTILINE
    )
    assert sorted(name for name, *_ in lines) == checkpoint_names()
    for name, first, last, command in lines:
        seeds = [run.training_seed for run in find_candidate(name).policies]
        assert seeds == list(range(int(first), int(last or first) + 1))
        if name in STUDENTS:
            assert command == f"-m agents.distillation {name} --seeds N"
            continue
        program, *words = command.replace(" N", " 7").split()
        assert program == "train.py"
        options = train.read_args([*words, "--gamma", "0.9"])
        expected = dataclasses.replace(TRAINED_ROWS[name], seed=7, gamma=0.9)
        assert options.hyperparameters == expected
        assert options.action_mode == expected.action_mode
        assert options.algo == expected.algo
