from dataclasses import dataclass

import pytest

from capsule_gym.command_line import Count, Positional, parse


@dataclass(frozen=True)
class Arguments:
    """Counts things."""

    name: Positional[str]
    """what is counted"""
    steps: Count = 100
    """how many"""

    def check(self) -> None:
        """Refuses what cannot be counted."""
        if self.name == "sand":
            raise ValueError(f"name must be something countable, got {self.name!r}")


def read(*words: str) -> Arguments:
    return parse(Arguments, "python -m count", words)


@pytest.mark.parametrize(("text", "value"), [("7", 7), ("8e6", 8_000_000), ("8_000", 8000), ("0", 0)])
def test_counts_are_written_in_several_ways(text, value):
    assert read("sheep", "--steps", text) == Arguments("sheep", value)


WRONG = [(["sheep", "--steps", text], text) for text in ("1.5", "-3", "many")]
WRONG += [(["sheep", "--slow"], "--slow"), ([], "required"), (["sheep", "--stesp", "3"], "--steps")]
WRONG += [(["sand"], "name must be something countable, got 'sand'")]


@pytest.mark.parametrize(("words", "said"), WRONG)
def test_a_wrong_command_line_ends_with_2_and_says_what_is_wrong(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        read(*words)
    assert ended.value.code == 2
    assert said.lower() in capsys.readouterr().err.lower()
