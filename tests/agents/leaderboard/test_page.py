import copy
import json
from pathlib import Path

import numpy as np
import pytest

from agents.leaderboard.page import END, HEAD_SETS, START, build, files, head, render, training_commands
from agents.leaderboard.rows import RESULTS, evaluate, load_rows
from baselines.evaluation.policies import checkpoint_names, find_candidate
from capsule_gym.evaluation_sets import FURTHER_SET_NAMES, SET_NAMES, load_set
from tests.agents.leaderboard.world import SETS, checked, read, row_of, table

ROOT = Path(__file__).resolve().parents[3]


def test_the_committed_pages_are_those_of_the_committed_board():
    for name, text in files(ROOT, read(ROOT)).items():
        assert (ROOT / name).read_text(encoding="utf-8") == text


def test_the_committed_board_is_that_of_the_committed_results():
    names = ("direct-ppo", "adaptive")
    board = build(load_rows(ROOT / RESULTS, names), [load_set(name) for name in SET_NAMES + FURTHER_SET_NAMES])
    recorded = read(ROOT)
    assert board["sets"] == recorded["sets"]
    assert board["rows"] == [row for row in recorded["rows"] if row["policy"] in names]


def test_versions_that_differ_between_rows_are_all_named():
    one, other = evaluate([find_candidate(name) for name in ("adaptive", "pd")], SETS, horizon=0.1)
    other.header["versions"] = {**one.header["versions"], "numpy": "1.0", "new": "2.0"}
    found = build([one, other], SETS)["versions"]
    assert found == {**one.header["versions"], "numpy": f"1.0, {np.__version__}", "new": "2.0"}


def test_every_committed_checkpoint_has_its_command():
    assert set(checkpoint_names()) <= set(training_commands())


def test_pages_of_other_boards(written):
    text = (written / "leaderboard.json").read_text()
    board = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    # Content that does not fit a telephone is folded.
    page = render(board)
    assert page.count("<details") == page.count("</details>") == 4
    # A small share of failures is not rounded to zero.
    row_of(board, "bold")["results"]["paper"] |= {"failures": 1, "episodes": 1000}
    lines = {row[0]: row for row in table(render(board), "## On every set")}
    assert lines["bold"][-1].replace("\N{NO-BREAK SPACE}", " ").endswith(" (< 1 %)")
    # Without the paper's controller there is no ratio to it.
    count = HEAD_SETS["paper"]
    rows = [copy.deepcopy(board["rows"][0]) | {"policy": f"better-{i:02}"} for i in range(count + 1)]
    assert {row[2] for row in table(head({**board, "rows": rows}))[2:]} == {"-"}
    names = [row[0] for row in table(head({**board, "rows": [*rows, *board["rows"]]}))[2:]]
    assert names == [f"better-{i:02}" for i in range(count)] + ["adaptive"]
    # The table also contains the fastest policies on another set, with their speed on that set.
    fast = copy.deepcopy(row_of(board, "wild")) | {"policy": "elsewhere"}
    speed = {"iqm": 99.0, "low": 98.0, "high": 99.5}
    fast["results"]["sticky"] = fast["results"]["paper"] | {"mean_speed": speed, "failures": 0}
    for row in (sets := {**board, "sets": {**board["sets"], "sticky": ""}, "rows": [*rows, *board["rows"], fast]})[
        "rows"
    ]:
        row["results"].setdefault("sticky", row["results"]["paper"])
    header, _, *lines = table(head(sets))
    assert [line[header.index("sticky (cm/s)")] for line in lines if line[0] == "elsewhere"] == ["99.00"]


def test_a_readme_without_a_marker_raises_an_error(written):
    for text in ("", START, END + START):
        (written / "README.md").write_text(text)
        assert checked(written)[0].startswith("README.md must contain <!-- --8<-- [start:leaderboard] --> and then")
        with pytest.raises(ValueError, match="README"):
            files(written, read(written))
