import json

import pytest

from agents.evaluation.candidates import all_candidates
from agents.evaluation.sets import parse_set
from agents.leaderboard.board import build
from agents.leaderboard.page import render
from baselines.gaits.archive import best_known_speed
from tests.agents.leaderboard.world import HORIZON, SETS, make_set, read, row_of, table


def test_board(written):
    board = json.loads((written / "leaderboard.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    speeds = [row["results"]["paper"]["mean_speed"]["iqm"] for row in board["rows"]]
    assert speeds == sorted(speeds, reverse=True)
    assert board["sets"] == {s.name: s.hash for s in SETS}
    learnt = row_of(board, "learnt")
    assert learnt["training_seeds"] == [0, 1]
    assert learnt["revision"] == "0123456789ab"
    assert sorted(learnt["files"]) == [f"seed-{i}/{name}" for i in (0, 1) for name in ("config.json", "model.zip")]
    assert learnt["results"]["paper"]["resampled"] == "seeds"
    assert learnt["results"]["paper"]["episodes"] == 6
    bold = row_of(board, "bold")
    assert (bold["training_seeds"], bold["revision"], bold["files"]) == ([], None, {})
    assert bold["results"]["nominal"]["mean_speed"]["low"] is None
    assert row_of(board, "wild")["results"]["paper"]["failures"] == 3


def test_every_number_has_a_spread(written):
    board = read(written)
    for row in board["rows"]:
        for summary in row["results"].values():
            numbers = {name: ends for name, ends in summary.items() if isinstance(ends, dict) and name != "spread"}
            assert {name: set(ends) for name, ends in numbers.items()} == {
                name: set(ends) for name, ends in summary["spread"].items() if name != "failures"
            }
    assert row_of(board, "bold")["results"]["paper"]["spread"]["mean_speed"]["iqm"] < 1e-5
    assert row_of(board, "twitch")["results"]["paper"]["spread"]["mean_speed"]["iqm"] > 0.1


def test_shares_of_the_best_known_speed(written):
    board = read(written)
    results = row_of(board, "bold")["results"]["nominal"]
    speed = results["mean_speed"]["iqm"]
    assert results["share_of_best_known"]["iqm"] == pytest.approx(speed / best_known_speed(0.5, 0.01), rel=1e-5)


def test_no_share_outside_the_table_of_gaits(world):
    jump = {"t": 0.3, "M": 0.5, "mu": 0.02}
    drift = parse_set({"name": "drift", "plants": [{"M": 0.5, "mu": 0.01, "seed": 0, "changes": [jump]}]})
    board = build(all_candidates(), [SETS[1], make_set("far", (0.5, 0.01), (0.5, 0.6)), drift], horizon=HORIZON)
    for row in board["rows"]:
        assert ["share_of_best_known" in summary for summary in row["results"].values()] == [True, False, False]
    assert table(render(board), "## Share")[0] == ["policy", "paper"]


def test_processes_give_the_same():
    # Spawned workers see the real policies, not the fakes.
    real = [c for c in all_candidates() if c.name == "zero"]
    assert build(real, SETS, jobs=2, horizon=0.1) == build(real, SETS, horizon=0.1)
