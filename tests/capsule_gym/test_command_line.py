"""Command lines from dataclasses: valid arguments and error messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pytest

from capsule_gym.command_line import Count, Positional, parse


@dataclass(frozen=True)
class Arguments:
    """Counts things."""

    name: Positional[str]
    """what is counted"""
    steps: Count = 100
    """how many"""
    fast: bool = False
    """without waiting"""
    order: Literal["up", "down"] = "up"
    """which way"""

    def check(self) -> None:
        """Refuses what cannot be counted."""
        if self.name == "sand":
            raise ValueError(f"name must be something countable, got {self.name!r}")


def read(*words: str) -> Arguments:
    return parse(Arguments, "python -m count", words)


@pytest.mark.parametrize(("text", "value"), [("7", 7), ("8e6", 8_000_000), ("8_000", 8000), ("0", 0)])
def test_counts_are_written_in_several_ways(text, value):
    assert read("sheep", "--steps", text) == Arguments("sheep", value)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sheep", "--steps", "1.5"], "1.5"),
        (["sheep", "--steps", "-3"], "-3"),
        (["sheep", "--steps", "many"], "many"),
        (["sheep", "--slow"], "--slow"),
        ([], "required"),
        (["sheep", "--stesp", "3"], "--steps"),
        (["sheep", "--order", "dwon"], "'up', 'down'"),
        (["sand"], "name must be something countable, got 'sand'"),
    ],
)
def test_a_wrong_command_line_ends_with_2_and_says_what_is_wrong(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        read(*words)
    assert ended.value.code == 2
    assert said.lower() in capsys.readouterr().err.lower()
