import copy
import re

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
    header = table(page)[0]
    shown = dict(zip(header, ranked, strict=True))
    speed = row_of(board, "learnt")["results"]["paper"]["mean_speed"]
    assert shown["cm/s [95 %]"].split() == f"{speed['iqm']:.2f} [{speed['low']:.2f}, {speed['high']:.2f}]".split()
    # A line may end between a number and its interval alone.
    assert shown["cm/s [95 %]"].count(" ") == 1
    assert "3/3 failed" in page
    for s in SETS:
        assert s.hash[:12] in page


def test_page_shows_shares_and_chaos(written):
    board = read(written)
    page = render(board)
    results = row_of(board, "bold")["results"]["paper"]
    assert "of optimum" in table(page)[0]
    assert ["bold", f"{results['share_of_optimum']['iqm']:.2f}"] in [row[:2] for row in table(page, "## Share")]
    found = {row[0]: row[1:] for row in table(page, "## Chaos")}
    low, high = (f"{row_of(board, 'bold')['disturbed'][end]:.2f}" for end in ("low", "high"))
    assert found["bold"] == [low, high, "< 0.005"]
    assert float(found["twitch"][2]) > 0.1


def test_page_folds_what_does_not_fit_a_telephone(written):
    page = render(read(written))
    assert page.count("<details") == page.count("</details>") == 4
    unfolded = re.sub(r"<details.*?</details>", "", page, flags=re.DOTALL)
    assert {len(row) for row in table(unfolded)} == {7}
    assert "peak torque" in page and "peak torque" not in unfolded


@pytest.mark.parametrize(
    ("failures", "episodes", "shown"), [(0, 100, ""), (1, 1000, " (< 1 %)"), (1, 100, " (1 %)"), (215, 1000, " (22 %)")]
)
def test_speeds_on_every_set_tell_the_share_that_fails(written, failures, episodes, shown):
    board = read(written)
    summary = row_of(board, "bold")["results"]["paper"]
    summary |= {"failures": failures, "episodes": episodes}
    (row,) = (row for row in table(render(board), "## On every set") if row[0] == "bold")
    place = table(render(board), "## On every set")[0].index("paper")
    assert row[place].replace("\N{NO-BREAK SPACE}", " ") == f"{summary['mean_speed']['iqm']:.2f}{shown}"


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
        with pytest.raises(ValueError, match=r"README\.md must hold <!-- --8<-- \[start:leaderboard\] -->"):
            with_head(text, board)
    # Broken markers stop the writing before anything is written, and are named by the check.
    (written / "README.md").write_text(START)
    with pytest.raises(ValueError, match="once each, or neither"):
        write(written, {**board, "rows": []})
    assert read(written) == board
    assert "once each, or neither" in checked(written)[0]
    (written / "README.md").unlink()
    assert checked(written) == []
