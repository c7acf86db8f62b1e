import json
import re

import numpy as np
import pytest

from agents import evaluate
from tests.agents.fakes import FIRST, write_run


def still(observations):
    """A policy without torque."""
    return np.zeros((len(observations), 1), np.float32)


def test_a_policy_is_compared_with_its_reference(world, tiny_file, capsys):
    assert evaluate.main(["learnt", "--set", tiny_file]) == 0
    printed = capsys.readouterr().out
    assert "learnt on the set tiny (3 episodes, " in printed
    assert "adaptive" in printed
    assert "\nmean speed (cm/s), interquartile mean " in printed
    assert "the intervals of 95 % are\nfor other training runs and other plants" in printed
    assert (
        "Differences to adaptive are taken episode by episode; their intervals are not\n" in printed
    )
    assert printed.endswith("adjusted for the number of metrics.\n")


def test_a_scripted_policy_has_no_other_training_runs(world, tmp_path, capsys):
    one_plant = tmp_path / "one.json"
    one_plant.write_text(json.dumps({"name": "one", "plants": [FIRST]}))
    assert evaluate.main(["bold", "--set", str(one_plant)]) == 0
    printed, progress = capsys.readouterr()
    assert "bold on the set one (1 episodes, " in printed
    assert "the intervals of 95 % are\nfor other plants." in printed
    # There is no bar unless standard error is a terminal.
    assert progress == ""


def shown(table, label):
    """The numbers of a line of the table, without their intervals."""
    (line,) = (line for line in table.splitlines() if line.startswith(f"{label}  "))
    return re.sub(r"\[.*?\]", "", line.removeprefix(label)).split()


def test_the_table_shows_the_interquartile_mean_and_the_mean_of_the_headline_metric():
    fast = [9.0, 10.0, 11.0, 30.0]
    slow = [8.0, 8.0, 8.0, 8.0]
    both = [
        [{"mean_speed": speed, "rms_torque": speed, "failed": 0.0} for speed in speeds]
        for speeds in (fast, slow)
    ]
    table = evaluate.comparison_table("fast", both[0], "slow", both[1])
    assert shown(table, "mean speed (cm/s), mean") == ["15.00", "8.00", "+7.00"]
    assert shown(table, "mean speed (cm/s), interquartile mean") == ["10.50", "8.00", "+2.50"]
    assert shown(table, "rms torque (N m)") == ["10.500", "8.000", "+2.500"]
    assert shown(table, "failures") == ["0/4", "0/4"]


def test_results_are_written_as_strict_json(world, tiny_file):
    out = world / "result.json"
    assert evaluate.main(["learnt", "--set", tiny_file, "--json", str(out)]) == 0
    # Strict JSON has no infinite numbers.
    result = json.loads(out.read_text(), parse_constant=pytest.fail)
    assert set(result) == {"policy", "set", "set_hash", "versions", "episodes", "summary"}
    assert (result["policy"], result["set"]) == ("learnt", "tiny")
    assert result["versions"]["numpy"] == np.__version__
    seeds = [episode["training_seed"] for episode in result["episodes"]]
    assert seeds == [2, 2, 2, 10, 10, 10]
    assert not list(world.glob(".*"))


def test_an_existing_file_is_kept_unless_overwritten(world, tiny_file, refused):
    out = world / "result.json"
    out.write_text("precious")
    words = ["adaptive", "--set", tiny_file, "--json", str(out)]
    error = refused(evaluate.main, words)
    assert "--json must name a new file unless --overwrite is given" in error
    assert out.read_text() == "precious"
    assert evaluate.main([*words, "--overwrite"]) == 0
    assert json.loads(out.read_text())["policy"] == "adaptive"


# The second error is about the reference, so the policy was accepted.
TRUST = [([], "'tests.agents.fakes:quiet', which"), (["--trust-controller"], "got 'nobody'")]


@pytest.mark.parametrize(("words", "message"), TRUST)
def test_a_control_law_of_another_package_must_be_trusted(
    world, tiny_file, refused, words, message
):
    write_run(
        world / "run",
        2,
        layers=((np.zeros((1, 10), np.float32), np.zeros(1, np.float32)),),
        mean=np.zeros(10),
        variance=np.ones(10),
        env_kwargs={"controller": "tests.agents.fakes:quiet"},
    )
    given = [str(world / "run"), "--set", tiny_file, "--against", "nobody", *words]
    assert message in refused(evaluate.main, given)


@pytest.fixture
def goals(tmp_path):
    """A set of two goals."""
    plants = [
        {"M": 0.5, "mu": 0.1, "seed": 0, "goal": 0.1},
        {"M": 0.5, "mu": 0.3, "seed": 0, "goal": -0.2},
    ]
    path = tmp_path / "goals.json"
    path.write_text(json.dumps({"name": "goals", "task": "goal", "plants": plants}))
    return str(path)


def test_a_set_of_another_task_is_compared_with_its_scripted_law(goals, tmp_path, capsys):
    out = tmp_path / "result.json"
    words = [f"{__name__}:still", "--trust", "--set", goals, "--json", str(out)]
    assert evaluate.main(words) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "goal-pulses" in printed
    assert "share of goals reached 0.0000 [0.0000, 0.0000] 1.0000 [1.0" in printed
    assert "reached, interquartile mean" not in printed
    first, _ = json.loads(out.read_text())["episodes"]
    assert first["goal"] == 0.1
    assert first["goal_time"] == pytest.approx(15.0)
    assert "share_of_optimum" not in first


@pytest.mark.parametrize("policy", ["velocity-pulses", "direct-ppo/seed-0"])
def test_a_policy_of_another_task_is_refused_before_an_evaluation(goals, capsys, policy):
    for words in ([policy], ["goal-pulses", "--against", policy]):
        with pytest.raises(SystemExit, match=r"^2$"):
            evaluate.main([*words, "--set", goals])
        printed, error = capsys.readouterr()
        assert "policy must be for the task 'goal' of the set 'goals'" in error
        assert printed == ""
