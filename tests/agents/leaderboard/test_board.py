import json

import numpy as np
import pytest

from agents.evaluation.policies import all_candidates, checkpoint_names, find_candidate
from agents.leaderboard.board import build, evaluate, training_commands
from agents.leaderboard.page import render
from agents.leaderboard.rows import static_header
from baselines.dynamic_programming import optimal_speed
from capsule_gym.evaluation_sets import parse_set
from tests.agents.leaderboard.world import SETS, board_of, make_set, read, row_of, table


def test_board(written):
    board = json.loads((written / "leaderboard.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    speeds = [row["results"]["paper"]["mean_speed"]["iqm"] for row in board["rows"]]
    assert speeds == sorted(speeds, reverse=True)
    assert board["sets"] == {s.name: s.hash for s in SETS}
    learnt = row_of(board, "learnt")
    assert learnt["training_seeds"] == [0, 1]
    assert learnt["revision"] == "0123456789ab"
    assert sorted(learnt["files"]) == [f"seed-{i}/policy.safetensors" for i in (0, 1)]
    assert learnt["results"]["paper"]["resampled"] == "seeds"
    assert learnt["results"]["paper"]["episodes"] == 6
    bold = row_of(board, "bold")
    assert (bold["training_seeds"], bold["revision"], bold["files"]) == ([], None, {})
    assert bold["results"]["nominal"]["mean_speed"]["low"] is None
    assert row_of(board, "wild")["results"]["paper"]["failures"] == 3


def test_what_noise_does_stands_in_every_row(written):
    board = read(written)
    assert all(set(row["disturbed"]) == {"low", "high"} for row in board["rows"])
    widths = {row["policy"]: row["disturbed"]["high"] - row["disturbed"]["low"] for row in board["rows"]}
    assert widths["bold"] < 1e-4
    assert widths["twitch"] > 0.1


def test_shares_of_the_optimal_speed(written):
    board = read(written)
    results = row_of(board, "bold")["results"]["nominal"]
    speed = results["mean_speed"]["iqm"]
    assert results["share_of_optimum"]["iqm"] == pytest.approx(speed / optimal_speed(0.5, 0.01), rel=1e-5)


def test_no_share_outside_the_table_of_optima(world):
    jump = {"t": 0.3, "M": 0.5, "mu": 0.02}
    drift = parse_set({"name": "drift", "plants": [{"M": 0.5, "mu": 0.01, "seed": 0, "changes": [jump]}]})
    start = parse_set({"name": "start", "plants": [{"M": 0.5, "mu": 0.01, "seed": 0, "theta": 0.0}]})
    sets = [SETS[1], make_set("far", (0.5, 0.01), (0.5, 0.6)), drift, start]
    board = board_of(all_candidates(), sets)
    for row in board["rows"]:
        assert ["share_of_optimum" in summary for summary in row["results"].values()] == [True, False, False, False]
    assert table(render(board), "## Share")[0] == ["policy", "paper"]


def test_rows_say_what_trained_them_and_what_they_build_on(written):
    board = read(written)
    assert row_of(board, "learnt")["trained_by"] == "python train.py --seed N"
    assert row_of(board, "learnt")["base"] is None
    assert "trained_by" not in row_of(board, "bold")
    assert "- `learnt`: PPO, the whole torque, trained with randomization wide. Trained by `python" in render(board)


def test_the_base_of_a_residual_is_the_policy_of_its_law_alone():
    names = ("adaptive", "residual-ppo", "residual-on-gait", "robust", "direct-ppo")
    bases = {each.name: static_header(each)["base"] for each in map(find_candidate, names)}
    assert bases == {
        "adaptive": None,
        "residual-ppo": "adaptive",
        "residual-on-gait": "gait-guarded",
        "robust": "gait-identifying",
        "direct-ppo": None,
    }


def test_versions_that_differ_between_rows_are_all_said():
    adaptive, zero = evaluate([find_candidate(name) for name in ("adaptive", "zero")], SETS, horizon=0.1)
    zero.header["versions"] = {**zero.header["versions"], "numpy": "1.0", "new": "2.0"}
    found = build([adaptive, zero], SETS)["versions"]
    assert found == {**adaptive.header["versions"], "numpy": f"1.0, {np.__version__}", "new": "2.0"}


def test_every_committed_checkpoint_has_its_command():
    assert set(checkpoint_names()) <= set(training_commands())


def test_processes_give_the_same():
    # Spawned workers import everything anew.
    real = [find_candidate(name) for name in ("zero", "direct-sac")]
    alone, shared = (list(evaluate(real, SETS, jobs=jobs, horizon=0.1)) for jobs in (1, 2))
    assert [row.name for row in alone] == ["zero", "direct-sac"]
    assert all(one.same_as(other) for one, other in zip(alone, shared, strict=True))
