"""The options of plant and pace: which plant they mean, and what they refuse."""

from __future__ import annotations

import pytest

from capsule_gym.command_line import parse
from capsule_gym.demo import FASTEST, SLOWEST, PlantOptions
from capsule_gym.evaluation_sets import load_set


def read(*words: str) -> PlantOptions:
    return parse(PlantOptions, "python -m show", words)


def test_the_options_mean_the_plants_of_the_set_from_the_seed_on():
    assert read().plants() == load_set("paper").plants
    assert read("--set", "drift", "--seed", "7").plants() == load_set("drift").from_seed(7)
    assert (
        read("--seed", "7", "--M", "0.6", "--mu", "0.05").plants()[0]
        == load_set("paper").from_seed(7, M=0.6, mu=0.05)[0]
    )


def test_a_set_may_be_a_file(tmp_path):
    path = tmp_path / "own.json"
    path.write_text(load_set("wide").to_json(), encoding="utf-8")
    assert read("--set", str(path)).plants() == load_set("wide").plants


@pytest.mark.parametrize("speed", [SLOWEST, FASTEST])
def test_the_slowest_and_the_fastest_pace_are_paces(speed):
    assert read("--speed", str(speed)).speed == speed


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--speed", "0.09"], "--speed must be a number from 0.1 to 20, got 0.09"),
        (["--speed", "20.1"], "--speed must be a number from 0.1 to 20, got 20.1"),
        (["--speed", "nan"], "--speed must be a number from 0.1 to 20, got nan"),
        (["--set", "papr"], "got 'papr'; did you mean 'paper'?"),
        (["--seed", "100"], "seed must be one of the set 'paper', 0 to 99, got 100"),
        (["--seed", "-1"], "must be an integer >= 0, got '-1'"),
        (["--M", "0"], "M must be a finite number"),
        (["--M", "0.05", "--mu", "2"], "Painleve"),
    ],
)
def test_plants_and_paces_that_do_not_exist_are_refused_in_a_line(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        read(*words)
    error = capsys.readouterr().err
    assert ended.value.code == 2 and said in error and error.count("\n") == 1
