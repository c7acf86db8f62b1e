import copy

import pytest

from agents.leaderboard.board import write
from agents.leaderboard.page import END, HEAD_ROWS, START, head, rank, render, with_head
from tests.agents.leaderboard.world import SETS, checked, read, row_of, table


def test_page(written):
    page = (written / "LEADERBOARD.md").read_text()
    board = read(written)
    assert page == render(board)
    (ranked,) = (row for row in table(page) if row[1] == "learnt")
    assert int(ranked[0]) == [row["policy"] for row in board["rows"]].index("learnt") + 1
    assert ranked[-1] == "`python -m agents.evaluate learnt --set paper`"
    assert "3/3 failed" in page
    for s in SETS:
        assert s.hash[:12] in page


def test_page_shows_shares_and_chaos(written):
    board = read(written)
    page = render(board)
    results = row_of(board, "bold")["results"]["paper"]
    assert "share of optimum" in table(page)[0]
    assert ["bold", f"{results['share_of_optimum']['iqm']:.2f}"] in [row[:2] for row in table(page, "## Share")]
    found = {row[0]: row[1:] for row in table(page, "## Chaos")}
    low, high = (f"{row_of(board, 'bold')['disturbed'][end]:.2f}" for end in ("low", "high"))
    assert found["bold"] == [low, high, "< 0.005"]
    assert float(found["twitch"][2]) > 0.1


def test_head_always_shows_the_reference(written):
    board = read(written)
    rows = [copy.deepcopy(row_of(board, "bold")) | {"policy": f"better-{i:02}"} for i in range(HEAD_ROWS + 1)]
    for row in rows:
        row["results"]["paper"]["mean_speed"]["iqm"] = 1e3
    board["rows"] = rank([*board["rows"], *rows])
    names = [row[0] for row in table(head(board))[2:]]
    assert names == [f"better-{i:02}" for i in range(HEAD_ROWS)] + ["adaptive"]


def test_readme_markers(written):
    board = read(written)
    assert with_head("# No markers\n", board) == "# No markers\n"
    for text in (START, END, END + START, START + END + END, START + START + END):
        with pytest.raises(ValueError, match=r"README\.md must hold <!-- leaderboard:start -->"):
            with_head(text, board)
    # Broken markers stop the writing before anything is written, and are named by the check.
    (written / "README.md").write_text(START)
    with pytest.raises(ValueError, match="once each, or neither"):
        write(written, {**board, "rows": []})
    assert read(written) == board
    assert "once each, or neither" in checked(written)[0]
    (written / "README.md").unlink()
    assert checked(written) == []
