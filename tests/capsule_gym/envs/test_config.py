"""The options of an environment: their types and descriptions are the same wherever they stand."""

import dataclasses
from typing import get_type_hints

import pytest

from capsule_gym import CapsuleEnv
from capsule_gym.envs.config import DOCS, EnvConfig, EnvOptions


def test_the_types_for_editors_are_those_of_the_options():
    expected = get_type_hints(EnvConfig)
    del expected["render_mode"]
    assert get_type_hints(EnvOptions) == expected


@pytest.mark.parametrize("name", [option.name for option in dataclasses.fields(EnvConfig)])
def test_the_documentation_describes_every_option(name):
    rows = [line.strip() for line in CapsuleEnv.__doc__.splitlines()]
    (row,) = [row for row in rows if row.startswith(f"| `{name}` | ")]
    assert row.endswith(f" | {DOCS[name]} |")


def test_a_torque_limit_of_zero_is_refused():
    with pytest.raises(ValueError, match=r"^torque_limit must be a finite number > 0 \(N m\)"):
        EnvConfig(torque_limit=0.0)
