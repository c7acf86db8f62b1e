from dataclasses import dataclass

import pytest

from capsule_gym.command_line import check_output, parse


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


def test_an_output_file_that_exists_is_overwritten_only_on_request(tmp_path):
    path = tmp_path / "table.csv"
    path.touch()
    check_output("--output", path, overwrite=True)
    with pytest.raises(ValueError, match="--output must name a new file unless --overwrite"):
        check_output("--output", path)
