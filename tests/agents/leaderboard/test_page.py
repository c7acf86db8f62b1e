import re

import numpy as np
import pytest

from agents.leaderboard import page
from agents.leaderboard.chart import contents, draw
from agents.leaderboard.page import _section, grouped, message
from baselines.drawing import BLUE, VERMILION
from capsule_gym.evaluation.candidates import Candidate
from tests import ROOT
from tests.agents.leaderboard.world import checked, edit_row, read, table
from tests.figures import assert_bars, texts


def row_of(board, name):
    return next(row for row in board["rows"] if row["policy"] == name)


def clearly(board, faster, slower, on):
    """Whether a mean exceeds another one, possibly of another set, by twice the half widths of both
    intervals."""
    first, second = (row_of(board, name)["results"][on]["mean_speed"] for name in (faster, slower))
    widths = sum(each["mean_high"] - each["mean_low"] for each in (first, second))
    return first["mean"] - second["mean"] >= widths


def test_the_committed_board_has_a_place_for_every_row_and_the_pages_and_the_message_are_true_of_it():
    board = read(ROOT)
    assert list(grouped(board)) == list(page.GROUPS)
    for name, text in page.files(ROOT, board).items():
        assert (ROOT / name).read_text(encoding="utf-8") == text, name
    assert clearly(board, "open-loop", "adaptive", "paper") and clearly(
        board, "pd", "open-loop", "paper"
    )
    assert all(clearly(board, name, "pd", "paper") for name in page.PERFECT)
    # With real sensors all of these but LQR fall below the PD.
    assert [name for name in page.PERFECT if not clearly(board, "pd", name, "real")] == ["lqr"]
    assert all(clearly(board, name, "pd", "real") for name in page.KEPT)
    # The seeds of direct-real differ more: of the least gain of learning, the interval is above the
    # PD's.
    pd, *learned = (
        row_of(board, name)["results"]["real"]["mean_speed"] for name in ("pd", *page.LEARNED)
    )
    assert all(each["mean_low"] > pd["mean_high"] for each in learned)
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d)?", message(board))]
    assert len(numbers) == 9 and np.isfinite(numbers).all()


def test_ranking_is_by_the_mean_with_the_worst_seed_and_the_difference_to_the_base(
    written, monkeypatch
):
    def fail_once(row):
        row.header.update(base="pd")
        # A single bad seed in 3 episodes changes the mean, but not the interquartile mean of the
        # set.
        row.scores["paper"][0] = [[9.0, 9.0, 9.0], [9.0, 9.0, -60.0]]
        row.scores["paper"][row.header["metrics"].index("failed")] = [
            [0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
        ]

    monkeypatch.setattr(Candidate, "base", property(lambda self: "pd" if self.trained else None))
    edit_row(written, "learnt", fail_once)
    board = read(written)
    speed = row_of(board, "learnt")["results"]["paper"]["mean_speed"]
    assert speed["iqm"] == 9.0 and speed["mean"] == -2.5 and speed["seeds"] == [9.0, -14.0]
    means = [row["results"]["paper"]["mean_speed"]["mean"] for row in board["rows"]]
    assert means == sorted(means, reverse=True) and board["rows"][-1]["policy"] == "learnt"
    text = (written / "LEADERBOARD.md").read_text()
    assert [line[1] for line in table(text) if line[0] == "learnt"] == ["-2.50 (1/6)"]
    header, _, *lines = table(text, "On the set `paper`")
    (line,) = (line for line in lines if line[0] == "learnt")
    assert (line[header.index("worst seed (cm/s)")], line[header.index("failed")]) == (
        "-14.00",
        "1/6",
    )
    rows = [row_of(board, name) for name in ("learnt", "pd")]
    speeds = [row["results"]["real"]["mean_speed"]["mean"] for row in rows]
    assert rows[0]["minus_base"]["real"]["mean"] == pytest.approx(speeds[0] - speeds[1], abs=1e-4)
    header, _, *lines = table(text, "On the set `real`")
    column = header.index("difference to base law on `real`")
    assert [line[0] for line in lines if line[column] != "-"] == ["learnt"]


def test_rows_without_a_group_are_shown_as_others(written):
    board = read(written)
    assert {row["policy"] for row in grouped(board)["Others"]} == {"wild", "rocking", "learnt"}
    shown = [label for label, bars in contents(board) if bars]
    assert shown == [row["policy"] for rows in grouped(board).values() for row in rows]
    # Rows of other pages are in their tables.
    tables = (written / page.TABLES).read_text()
    for name, (names, _) in page.SECTIONS.items():
        assert {line[0] for line in table(tables, f"start:{name}]")[2:]} == set(names)


def test_a_readme_without_a_marker_raises_an_error(written):
    whole = (written / "README.md").read_text()
    start, end = _section("message", "").split("\n\n")
    for text in (
        "",
        whole.replace(start, ""),
        whole.replace(end, ""),
        end + whole.replace(end, ""),
    ):
        (written / "README.md").write_text(text)
        with pytest.raises(
            ValueError, match=r"README\.md must contain <!-- --8<-- \[start:message\] --> and then"
        ):
            checked(written)


def test_the_chart_has_a_bar_for_every_mean_and_marks_failures(written, saved_figures):
    board = read(written)
    draw(board)
    (axes,) = saved_figures[0].axes
    ticks, bars, marks = axes.get_yticklabels(), [], []
    for on, colour, side in (("paper", BLUE, -0.19), ("real", VERMILION, 0.19)):
        for y, tick in enumerate(ticks):
            if tick.get_fontweight() == "normal":
                found = row_of(board, tick.get_text().replace("\n", ""))["results"][on]
                # From top to bottom, with the bar of `paper` above that of `real`.
                bars.append((y + side, found["mean_speed"]["mean"], colour))
                if share := found["failures"] / found["episodes"]:
                    marks.append(
                        (f"\u00d7 {100.0 * share:.0f} %", max(bars[-1][1], 0.0) + 0.15, y + side)
                    )
    assert_bars(axes, *bars)
    assert {round(bar.get_height(), 9) for bar in axes.patches} == {0.38}
    assert [(text.get_text(), *text.xy) for text in axes.texts] == marks and len(marks) > 1
    assert texts(tick for tick in ticks if tick.get_fontweight() == "bold") == list(grouped(board))
    low, high = axes.get_ylim()
    assert low > len(ticks) - 1.0 + 0.38 and high < -0.38 and axes.get_xlim()[0] == 0.0
    assert [name.partition(":")[0] for name in texts(saved_figures[0].legends[0].texts)] == [
        "paper",
        "real",
    ]
