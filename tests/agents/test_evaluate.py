import json

import numpy as np
import pytest

from agents import evaluate
from tests.agents.fakes import write_run


def still(observations):
    """A policy without torque."""
    return np.zeros((len(observations), 1), np.float32)


def test_command_line_writes_results_and_keeps_existing_ones(world, tiny_file, capsys, refused):
    out = world / "result.json"
    assert evaluate.main(["learnt", "--set", tiny_file, "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "learnt on the set tiny (3 episodes, " in printed and "adaptive" in printed
    assert "the intervals of 95 % are\nfor other training runs and other plants" in printed
    # Strict JSON has no infinite numbers.
    result = json.loads(out.read_text(), parse_constant=lambda name: pytest.fail(name))
    assert set(result) == {"policy", "set", "set_hash", "versions", "episodes", "summary"}
    assert (result["policy"], result["set"], result["versions"]["numpy"]) == (
        "learnt",
        "tiny",
        np.__version__,
    )
    assert [e["training_seed"] for e in result["episodes"]] == [2, 2, 2, 10, 10, 10] and not list(
        world.glob(".*")
    )
    out.write_text("precious")
    error = refused(evaluate.main, ["bold", "--set", tiny_file, "--json", str(out)])
    assert (
        "--json must name a new file unless --overwrite is given" in error
        and out.read_text() == "precious"
    )
    assert evaluate.main(["adaptive", "--set", tiny_file, "--json", str(out), "--overwrite"]) == 0
    assert json.loads(out.read_text())["policy"] == "adaptive"


def test_a_control_law_of_another_package_must_be_trusted(world, tiny_file, refused):
    fields = {
        "layers": ((np.zeros((1, 10), np.float32), np.zeros(1, np.float32)),),
        "mean": np.zeros(10),
    }
    write_run(
        world / "run",
        2,
        **fields,
        variance=np.ones(10),
        env_kwargs={"controller": "tests.agents.fakes:quiet"},
    )
    # The second error is about the reference, so the policy was accepted.
    for words, message in (
        ([], "'tests.agents.fakes:quiet', which"),
        (["--trust-controller"], "got 'nobody'"),
    ):
        given = [str(world / "run"), "--set", tiny_file, "--against", "nobody", *words]
        assert message in refused(evaluate.main, given)


def test_a_set_of_another_task_is_compared_with_its_scripted_law(tmp_path, capsys, refused):
    plants = [
        {"M": 0.5, "mu": mu, "seed": 0, "goal": goal} for mu, goal in ((0.1, 0.1), (0.3, -0.2))
    ]
    path = tmp_path / "goals.json"
    path.write_text(json.dumps({"name": "goals", "task": "goal", "plants": plants}))
    still = f"{__name__}:still"
    assert (
        evaluate.main(
            [still, "--trust", "--set", str(path), "--json", str(tmp_path / "result.json")]
        )
        == 0
    )
    printed = " ".join(capsys.readouterr().out.split())
    assert (
        "goal-pulses" in printed
        and "share of goals reached 0.0000 [0.0000, 0.0000] 1.0000 [1.0" in printed
    )
    (first, _) = json.loads((tmp_path / "result.json").read_text())["episodes"]
    assert (first["goal"], first["goal_time"]) == (
        0.1,
        pytest.approx(15.0),
    ) and "share_of_optimum" not in first
    for policy in ("velocity-pulses", "direct-ppo/seed-0"):
        error = refused(evaluate.main, [policy, "--set", str(path)])
        assert "policy must be for the task 'goal' of the set 'goals'" in error
