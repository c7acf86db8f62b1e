import json

import pytest

from agents.evaluation.candidates import all_candidates
from agents.evaluation.sets import parse_set
from agents.leaderboard.board import build
from agents.leaderboard.page import render
from baselines.optimum import optimal_speed
from tests.agents.leaderboard.world import HORIZON, SETS, make_set, read, row_of, table


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
    board = build(all_candidates(), sets, horizon=HORIZON)
    for row in board["rows"]:
        assert ["share_of_optimum" in summary for summary in row["results"].values()] == [True, False, False, False]
    assert table(render(board), "## Share")[0] == ["policy", "paper"]


def test_processes_give_the_same():
    # Spawned workers import everything anew.
    real = [c for c in all_candidates() if c.name in ("zero", "direct-sac")]
    assert build(real, SETS, jobs=2, horizon=0.1) == build(real, SETS, horizon=0.1)
