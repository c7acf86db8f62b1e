import copy
import json
import re

import numpy as np
import pytest

from agents.evaluation.policies import checkpoint_names, find_candidate
from agents.leaderboard.page import END, HEAD_ROWS, START, build, files, head, render, training_commands
from agents.leaderboard.rows import evaluate
from tests.agents.leaderboard.world import SETS, checked, make_set, read, row_of, table


def test_the_board(written):
    board = json.loads((written / "leaderboard.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    speeds = [row["results"]["paper"]["mean_speed"]["iqm"] for row in board["rows"]]
    assert speeds == sorted(speeds, reverse=True)
    assert board["sets"] == {s.name: s.hash for s in SETS}
    learnt = row_of(board, "learnt")
    assert (learnt["training_seeds"], learnt["revision"], learnt["base"]) == ([0, 1], "0123456789ab", None)
    assert sorted(learnt["files"]) == [f"seed-{i}/policy.safetensors" for i in (0, 1)]
    assert (learnt["results"]["paper"]["resampled"], learnt["results"]["paper"]["episodes"]) == ("seeds", 6)
    assert learnt["trained_by"] == "python train.py --seed N"
    bold = row_of(board, "bold")
    assert (bold["training_seeds"], bold["revision"], bold["files"]) == ([], None, {})
    assert "trained_by" not in bold
    assert bold["results"]["nominal"]["mean_speed"]["low"] is None
    assert (
        float(f"{bold['results']['paper']['rms_torque']['iqm']:.6g}") == bold["results"]["paper"]["rms_torque"]["iqm"]
    )
    assert row_of(board, "wild")["results"]["paper"]["failures"] == 3


def test_versions_that_differ_between_rows_are_all_named():
    zero, random = evaluate([find_candidate(name) for name in ("zero", "random")], SETS, horizon=0.1)
    random.header["versions"] = {**zero.header["versions"], "numpy": "1.0", "new": "2.0"}
    found = build([zero, random], SETS)["versions"]
    assert found == {**zero.header["versions"], "numpy": f"1.0, {np.__version__}", "new": "2.0"}


def test_every_committed_checkpoint_has_its_command():
    assert set(checkpoint_names()) <= set(training_commands())


def test_the_page(written):
    page = (written / "LEADERBOARD.md").read_text()
    board = read(written)
    assert page == render(board)
    (ranked,) = (row for row in table(page) if row[1] == "learnt")
    assert int(ranked[0]) == [row["policy"] for row in board["rows"]].index("learnt") + 1
    shown = dict(zip(table(page)[0], ranked, strict=True))
    speed = row_of(board, "learnt")["results"]["paper"]["mean_speed"]
    assert shown["cm/s [95 %]"].split() == f"{speed['iqm']:.2f} [{speed['low']:.2f}, {speed['high']:.2f}]".split()
    # A line may break between a number and its interval only.
    assert shown["cm/s [95 %]"].count(" ") == 1
    row_of(board, "adaptive")["results"]["paper"]["mean_speed"]["iqm"] = 2.0
    (ranked,) = (row for row in table(render(board)) if row[1] == "learnt")
    assert ranked[3] == f"{speed['iqm'] / 2.0:.2f}"
    assert "3/3 failed" in page
    assert all(s.hash[:12] in page for s in SETS)
    assert "- `learnt`: PPO, the whole torque, trained with randomization wide. Trained by `python" in page
    # What does not fit a telephone is folded.
    assert page.count("<details") == page.count("</details>") == 4
    unfolded = re.sub(r"<details.*?</details>", "", page, flags=re.DOTALL)
    assert {len(row) for row in table(unfolded)} == {7}
    assert "peak torque" in page and "peak torque" not in unfolded


def test_the_page_shows_shares_and_sensitivity(written):
    board = read(written)
    page = render(board)
    share = row_of(board, "bold")["results"]["paper"]["share_of_optimum"]
    assert ["bold", f"{share['iqm']:.2f}"] in [row[:2] for row in table(page, "## Share")]
    found = {row[0]: row[1:] for row in table(page, "## Sensitivity")}
    low, high = (f"{row_of(board, 'bold')['disturbed'][end]:.2f}" for end in ("low", "high"))
    assert found["bold"] == [low, high, "< 0.005"]
    assert float(found["twitch"][2]) > 0.1


def test_sets_outside_the_table_of_optima_have_no_share(world):
    sets = [SETS[1], make_set("far", (0.5, 0.01), (0.5, 0.6))]
    board = build(list(evaluate([find_candidate("bold")], sets, horizon=0.1)), sets)
    assert ["share_of_optimum" in summary for summary in board["rows"][0]["results"].values()] == [True, False]
    assert table(render(board), "## Share")[0] == ["policy", "paper"]


@pytest.mark.parametrize(
    ("failures", "episodes", "shown"), [(0, 100, ""), (1, 1000, " (< 1 %)"), (1, 100, " (1 %)"), (215, 1000, " (22 %)")]
)
def test_speeds_on_every_set_name_the_share_that_fails(written, failures, episodes, shown):
    board = read(written)
    summary = row_of(board, "bold")["results"]["paper"]
    summary |= {"failures": failures, "episodes": episodes}
    (row,) = (row for row in table(render(board), "## On every set") if row[0] == "bold")
    place = table(render(board), "## On every set")[0].index("paper")
    assert row[place].replace("\N{NO-BREAK SPACE}", " ") == f"{summary['mean_speed']['iqm']:.2f}{shown}"


def test_the_head_always_shows_the_baseline(written):
    board = read(written)
    rows = [copy.deepcopy(row_of(board, "bold")) | {"policy": f"better-{i:02}"} for i in range(HEAD_ROWS + 1)]
    board["rows"] = [*rows, *board["rows"]]
    names = [row[0] for row in table(head(board))[2:]]
    assert names == [f"better-{i:02}" for i in range(HEAD_ROWS)] + ["adaptive"]


def test_a_readme_without_a_marker_raises_an_error(written):
    for text in ("", START, END + START):
        (written / "README.md").write_text(text)
        assert checked(written)[0].startswith("README.md must hold <!-- --8<-- [start:leaderboard] --> and then")
        with pytest.raises(ValueError, match="README"):
            files(written, read(written))
