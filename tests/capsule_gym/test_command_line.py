from dataclasses import dataclass

import pytest

from capsule_gym.command_line import PositiveCount, check_output, parse


@dataclass(frozen=True)
class Options:
    """Options of a command.

    Args:
        count: a number.
    """

    count: int = 1


@pytest.mark.parametrize(("default", "count"), [(None, 1), (Options(count=5), 5)])
def test_a_default_replaces_those_of_the_fields(default, count):
    assert parse(Options, "prog", [], default=default) == Options(count=count)


def test_words_replace_a_default():
    assert parse(Options, "prog", ["--count", "7"], default=Options(count=5)).count == 7


@dataclass(frozen=True)
class Choice:
    """Does something.

    Examples:
      prog --fast

    Args:
        fast: do it fast.
    """

    fast: bool = False


def test_the_help_names_the_command_and_shows_its_description_before_the_options(capsys):
    with pytest.raises(SystemExit):
        parse(Choice, "python -m prog", ["--help"])
    said = capsys.readouterr().out
    assert "usage: python -m prog " in said
    assert "Examples:\n  prog --fast" in said
    assert "Args:" not in said


def test_a_flag_has_no_negation(capsys):
    assert parse(Choice, "prog", ["--fast"]).fast
    with pytest.raises(SystemExit):
        parse(Choice, "prog", ["--no-fast"])
    assert "--no-fast" in capsys.readouterr().err


@dataclass(frozen=True)
class Steps:
    """Options of another command.

    Args:
        steps: a number of steps.
    """

    steps: PositiveCount = 1


@pytest.mark.parametrize(("word", "steps"), [("7", 7), ("8e6", 8_000_000), ("2.5e3", 2500)])
def test_a_count_may_have_an_exponent(word, steps):
    assert parse(Steps, "prog", ["--steps", word]).steps == steps


@pytest.mark.parametrize("word", ["0", "-3", "1.5", "2.5e0", "nan", "inf", "many"])
def test_a_count_is_a_whole_number_from_1_on(word, capsys):
    with pytest.raises(SystemExit):
        parse(Steps, "prog", ["--steps", word])
    assert word in capsys.readouterr().err


def test_an_output_file_that_exists_is_overwritten_only_on_request(tmp_path):
    path = tmp_path / "table.csv"
    path.touch()
    check_output("--output", path, overwrite=True)
    with pytest.raises(ValueError, match="--output must name a new file unless --overwrite"):
        check_output("--output", path)
