"""The hyperparameters of training: options shared with the environment have its descriptions and
defaults."""

import dataclasses
import json
import math
import re

import pytest

import train
from agents.analysis.curves import read_evaluations
from agents.distillation.config import STUDENTS
from agents.distillation.network import CLIP, EPSILON, MIN_VARIANCE
from agents.training.config import (
    CONFIG,
    EVALUATIONS,
    RANGES,
    OffPolicyConfig,
    PPOConfig,
    SACConfig,
    read_config,
)
from agents.training.presets import PRESETS, TRAINED_ROWS
from capsule_gym.evaluation.candidates import CHECKPOINTS, checkpoint_names, find_candidate
from capsule_gym.files import to_json
from capsule_gym.policies.policy import IMITATION
from tests.agents.training.small import evaluated


def config_with(name, value):
    config = next(each for each in PRESETS.values() if hasattr(each, name))
    return dataclasses.replace(config, **{name: value})


def assert_refused(name, value):
    words, *_ = RANGES[name]
    with pytest.raises(ValueError, match=f"^{name} must be {re.escape(words)}, got"):
        config_with(name, value).check()


@pytest.mark.parametrize("name", RANGES)
def test_a_range_begins_where_its_words_say(name):
    words, low, _, _ = RANGES[name]
    if ">= " in words or "[" in words:
        config_with(name, low).check()
    else:
        assert_refused(name, low)


@pytest.mark.parametrize("name", RANGES)
def test_a_range_ends_where_its_words_say(name):
    _, _, high, _ = RANGES[name]
    if math.isfinite(high):
        config_with(name, high).check()
    else:
        assert_refused(name, high)


@pytest.mark.parametrize("key", PRESETS)
def test_a_preset_is_evaluated_at_its_end(key):
    assert PRESETS[key].total_steps % PRESETS[key].evaluate_every == 0


def test_off_policy_presets_take_fewer_steps():
    on_policy = [each for each in PRESETS.values() if isinstance(each, PPOConfig)]
    off_policy = [each for each in PRESETS.values() if isinstance(each, OffPolicyConfig)]
    most = max(config.total_steps for config in off_policy)
    assert most < min(config.total_steps for config in on_policy)


@pytest.mark.parametrize("action_mode", ["residual", "direct"])
def test_the_preset_of_tqc_has_the_settings_of_sac(action_mode):
    tqc = PRESETS[action_mode, "tqc"]
    settings = {field.name: getattr(tqc, field.name) for field in dataclasses.fields(SACConfig)}
    assert SACConfig(**settings) == PRESETS[action_mode, "sac"]


@pytest.mark.parametrize("action_mode", ["residual", "direct"])
def test_the_preset_of_td3_explores(action_mode):
    assert PRESETS[action_mode, "td3"].action_noise > 0.0


@pytest.mark.parametrize("algo", ["ppo", "recurrentppo"])
def test_the_control_law_cannot_counteract_a_residual_on_policy(algo):
    assert PRESETS["residual", algo].total_torque


def record_of(name):
    return json.loads((CHECKPOINTS / name / CONFIG).read_text("utf-8"))


def assert_policies(name, env_kwargs, algorithm, hidden):
    revision = record_of(name)["revision"]
    for policy in find_candidate(name).policies:
        assert policy.env_kwargs == evaluated(env_kwargs)
        assert policy.algorithm == algorithm
        assert policy.revision == revision
        assert [bias.size for _, bias in (*policy.layers, *policy.head)] == hidden


@pytest.mark.parametrize("name", TRAINED_ROWS)
def test_a_rows_settings_are_those_that_its_policies_were_trained_with(name):
    settings = TRAINED_ROWS[name]
    assert dataclasses.replace(read_config(CHECKPOINTS / name), seed=0) == settings
    hidden = [settings.hidden, settings.hidden, 1]
    assert_policies(name, settings.env_kwargs(), settings.algo, hidden)


@pytest.mark.parametrize("name", TRAINED_ROWS)
def test_a_row_was_evaluated_until_the_end_of_its_training(name):
    settings = TRAINED_ROWS[name]
    rollout = settings.num_envs * (settings.n_steps if isinstance(settings, PPOConfig) else 1)
    ends = [
        math.ceil(steps / rollout) * rollout
        for steps in (settings.evaluate_every, settings.total_steps)
    ]
    for path in (CHECKPOINTS / name).glob(f"*/{EVALUATIONS}"):
        steps, _ = read_evaluations(path, settings.task)
        assert [steps[0], steps[-1]] == ends


@pytest.mark.parametrize("name", STUDENTS)
def test_a_students_settings_are_those_that_its_policies_were_trained_with(name):
    student = STUDENTS[name]
    expected = json.loads(to_json(dataclasses.asdict(student)))
    assert record_of(name)["hyperparameters"] == expected
    first = student.units or student.hidden
    assert_policies(name, student.env_kwargs, IMITATION, [first, student.hidden, 1])


@pytest.mark.parametrize("name", STUDENTS)
def test_a_students_policies_have_its_normalisation(name):
    for policy in find_candidate(name).policies:
        assert (policy.clip, policy.epsilon) == (CLIP, EPSILON)


def test_the_least_variance_of_a_student_is_bounded():
    policies = find_candidate("dp-distilled-wide").policies
    assert min(policy.variance.min() for policy in policies) == MIN_VARIANCE


def test_the_table_of_commands_names_every_row_and_its_seeds():
    page = (CHECKPOINTS / "README.md").read_text(encoding="utf-8")
    row = r"^\| `([\w-]+)` \| (\d+)(?: to (\d+))? \| `python (.*)` \|$"
    lines = re.findall(row, page, re.MULTILINE)
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
        assert (options.action_mode, options.algo) == (expected.action_mode, expected.algo)
