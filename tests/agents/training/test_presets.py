"""The hyperparameters of training: what they share with the environment is the environment's."""

from __future__ import annotations

import dataclasses
from typing import get_args, get_type_hints

from agents.training.presets import PPOConfig
from capsule_gym.options import DOCS, Options
from capsule_gym.parameters import RANDOMIZATIONS


def test_the_command_line_of_a_training_run_takes_its_words_and_defaults_from_the_options():
    fields = {field.name: field for field in dataclasses.fields(PPOConfig)}
    hints = get_type_hints(PPOConfig, include_extras=True)
    shared = [name for name in DOCS if name in fields]
    assert set(shared) > {"torque_limit", "residual_limit", "observe_parameters", "energy_weight"}
    assert set(PPOConfig().env_kwargs()) == set(shared)
    for name in ("torque_limit", "observe_parameters", "energy_weight"):
        assert fields[name].default == getattr(Options, name)
    for name in ("torque_limit", "residual_limit", "observe_parameters", "energy_weight", "termination_penalty"):
        (about,) = hints[name].__metadata__
        assert DOCS[name][1:] in about.help
    assert get_args(hints["randomization"]) == tuple(RANDOMIZATIONS)
