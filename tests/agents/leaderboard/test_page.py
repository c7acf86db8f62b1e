import re

import numpy as np
import pytest

from agents.leaderboard import page
from agents.leaderboard.chart import contents, draw
from agents.leaderboard.page import grouped, message
from agents.leaderboard.rows import LeaderboardRow
from baselines.drawing import BLUE, VERMILION
from capsule_gym.evaluation.candidates import Candidate
from capsule_gym.evaluation.statistics import paired_difference
from tests import ROOT
from tests.agents.leaderboard.world import checked, edit_row, read, table
from tests.figures import assert_bars, texts


def row_of(board, name):
    return next(row for row in board["rows"] if row["policy"] == name)


def speed_of(board, name, set_name):
    return row_of(board, name)["results"][set_name]["mean_speed"]


def undecided(board, first, second, set_name):
    found = board["comparisons"]["undecided"][set_name]
    return second in found.get(first, ()) or first in found.get(second, ())


def clearly(board, faster, slower, set_name):
    """Whether a mean exceeds another one, and the comparison of all rows decides so."""
    speeds = [speed_of(board, name, set_name)["mean"] for name in (faster, slower)]
    return speeds[0] > speeds[1] and not undecided(board, faster, slower, set_name)


@pytest.fixture(scope="module")
def committed():
    return read(ROOT)


def test_every_committed_row_has_a_group(committed):
    assert list(grouped(committed)) == list(page.GROUPS)


def test_the_committed_pages_are_those_of_the_board(committed):
    for name, text in page.files(ROOT, committed).items():
        assert (ROOT / name).read_text(encoding="utf-8") == text, name


def test_the_message_is_true_of_perfect_sensors(committed):
    assert clearly(committed, "open-loop", "adaptive", "paper")
    assert clearly(committed, "pd", "open-loop", "paper")
    assert all(clearly(committed, name, "pd", "paper") for name in page.PERFECT)


def test_the_message_is_true_of_real_sensors(committed):
    # All of these but LQR fall below the PD.
    faster = [name for name in page.PERFECT if not clearly(committed, "pd", name, "real")]
    assert faster == ["lqr"]
    assert all(clearly(committed, name, "pd", "real") for name in page.KEPT)


def test_the_message_is_true_of_learning(committed):
    speeds = [speed_of(committed, name, "real")["mean"] for name in page.KEPT]
    assert speeds == sorted(speeds)
    assert clearly(committed, "dp-distilled", "residual-real", "real")
    assert clearly(committed, "dp-distilled-real", "dp-distilled", "real")


def test_the_message_has_finite_numbers(committed):
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d)?", message(committed))]
    assert len(numbers) == 10
    assert np.isfinite(numbers).all()


@pytest.fixture
def with_a_failure(written, monkeypatch):
    """The world after a failure in an episode of the second seed of `learnt`, whose base is `pd`.

    It changes the mean, but not the interquartile mean of the set.
    """

    def fail_once(row):
        row.header["base"] = "pd"
        failed = row.header["metrics"].index("failed")
        scores = row.scores["paper"]
        scores[0] = 9.0
        scores[failed] = 0.0
        scores[0, 1, 2] = -60.0
        scores[failed, 1, 2] = 1.0

    monkeypatch.setattr(Candidate, "base", property(lambda self: "pd" if self.trained else None))
    edit_row(written, "learnt", fail_once)
    return written


def columns_of(text, title):
    """The cells of every row of a table by column."""
    header, _, *lines = table(text, title)
    return {line[0]: dict(zip(header, line, strict=True)) for line in lines}


def test_ranking_is_by_the_mean(with_a_failure):
    board = read(with_a_failure)
    speed = speed_of(board, "learnt", "paper")
    assert (speed["iqm"], speed["mean"], speed["seeds"]) == (9.0, -2.5, [9.0, -14.0])
    means = [row["results"]["paper"]["mean_speed"]["mean"] for row in board["rows"]]
    assert means == sorted(means, reverse=True)
    assert board["rows"][-1]["policy"] == "learnt"


def test_tables_show_failures_and_the_worst_seed(with_a_failure):
    text = (with_a_failure / "LEADERBOARD.md").read_text()
    assert [line[1] for line in table(text) if line[0] == "learnt"] == ["-2.50 (1/6)"]
    cells = columns_of(text, "On the set `paper`")["learnt"]
    assert (cells["worst seed (cm/s)"], cells[page.FAILED]) == ("-14.00", "1/6 [3.0,\xa056.4]")


def test_tables_show_the_difference_to_the_base_law(with_a_failure):
    board = read(with_a_failure)
    for set_name in page.DETAILED_SETS:
        own, base = (speed_of(board, name, set_name)["mean"] for name in ("learnt", "pd"))
        difference = row_of(board, "learnt")["minus_base"][set_name]["mean"]
        assert difference == pytest.approx(own - base, abs=1e-4)
    lines = columns_of((with_a_failure / "LEADERBOARD.md").read_text(), "On the set `real`")
    column = "difference to base law on `real`"
    assert [name for name, cells in lines.items() if cells[column] != "-"] == ["learnt"]


def test_tables_show_the_lowest_decile_beside_the_worst_seed(with_a_failure):
    text = (with_a_failure / "LEADERBOARD.md").read_text()
    cells = columns_of(text, "On the set `paper`")["learnt"]
    # Means of both seeds on the three plants: 9, 9 and (9 - 60) / 2.
    assert cells["lowest decile"] == f"{-25.5 + 0.2 * 34.5:.2f}"
    assert list(cells).index("lowest decile") == list(cells).index("worst seed (cm/s)") + 1


def edited(written, **speeds):
    """The board after rows got these speeds on the three plants of `paper`."""
    for name, speed in speeds.items():

        def change(row, speed=speed):
            row.scores["paper"][0] = speed

        edit_row(written, name, change)
    return read(written)


def test_pairs_that_differ_on_every_plant_are_decided(written):
    board = edited(written, pd=[5.0, 5.1, 5.2], lqr=[6.0, 6.1, 6.2], mpc=[5.0, 9.0, 1.0])
    assert clearly(board, "lqr", "pd", "paper")
    assert undecided(board, "pd", "mpc", "paper")


def test_a_difference_that_a_single_test_would_find_is_not_decided_among_many(written):
    board = edited(written, pd=[5.0, 5.0, 5.0], lqr=[6.0, 6.1, 6.2])
    both = [row_of(board, name)["results"]["paper"]["mean_speed"] for name in ("pd", "lqr")]
    assert both[0]["mean_high"] < both[1]["mean_low"]
    assert undecided(board, "pd", "lqr", "paper")


def test_comparisons_are_of_means():
    def row(name, speeds):
        scores = dict.fromkeys(page.DETAILED_SETS, np.array([[speeds]]))
        return LeaderboardRow({"policy": name, "metrics": ["mean_speed"]}, scores)

    # One plant leaves the mean difference undecided, not the interquartile mean.
    speeds = [6.0, 6.1] * 3 + [6.0, 3.2]
    assert 0.05 < paired_difference([speeds], [[5.0] * 8], mean=True).p_value < 0.1
    assert paired_difference([speeds], [[5.0] * 8]).p_value < 1e-6
    found = page._comparisons([row("pd", [5.0] * 8), row("lqr", speeds)])
    assert found == {"pairs": 2, "undecided": {"paper": {"pd": ["lqr"]}, "real": {"pd": ["lqr"]}}}


def test_numbers_of_the_board_have_six_significant_digits(written):
    board = edited(written, pd=[0.1, 0.3, 1.6])
    assert speed_of(board, "pd", "paper")["mean"] == 0.666667


def test_comparisons_are_those_of_all_pairs_on_both_sets(committed):
    rows = sum(len(names) for names in page.GROUPS.values())
    assert committed["comparisons"]["pairs"] == rows * (rows - 1)
    assert page.comparisons(committed) in (ROOT / "LEADERBOARD.md").read_text()


def test_rows_without_a_group_are_shown_as_others(written):
    board = read(written)
    assert {row["policy"] for row in grouped(board)["Others"]} == {"wild", "rocking", "learnt"}
    shown = [label for label, bars in contents(board) if bars]
    assert shown == [row["policy"] for rows in grouped(board).values() for row in rows]


def test_rows_of_other_pages_are_in_their_tables(written):
    tables = (written / page.TABLES).read_text()
    for name, (names, _) in page.SECTIONS.items():
        assert set(columns_of(tables, f"start:{name}]")) == set(names)


START, END = page._markers("message")


@pytest.mark.parametrize("missing", [(START, END), (START,), (END,)])
def test_a_readme_without_a_marker_raises_an_error(written, missing):
    readme = written / "README.md"
    text = readme.read_text()
    for marker in missing:
        text = text.replace(marker, "")
    readme.write_text(text)
    with pytest.raises(ValueError, match=re.escape(f"README.md must contain {START} and then")):
        checked(written)


def test_a_readme_with_markers_in_another_order_raises_an_error(written):
    readme = written / "README.md"
    readme.write_text(END + readme.read_text().replace(END, ""))
    with pytest.raises(ValueError, match=re.escape(f"README.md must contain {START} and then")):
        checked(written)


@pytest.fixture
def board(written):
    return read(written)


@pytest.fixture
def axes(board, saved_figures):
    """The panel of the chart."""
    draw(board)
    return saved_figures[0].axes[0]


# Distances from the middle of a line, in lines: the bar of `paper` is above that of `real`.
SIDES = {"paper": -0.19, "real": 0.19}


def drawn_results(axes, board, set_name):
    """The middles of the bars of a set, from top to bottom, and the results that they show."""
    for y, tick in enumerate(axes.get_yticklabels()):
        if tick.get_fontweight() == "normal":
            name = tick.get_text().replace("\n", "")
            yield y + SIDES[set_name], row_of(board, name)["results"][set_name]


def test_the_chart_has_a_bar_for_every_mean(axes, board):
    bars = []
    for set_name, colour in (("paper", BLUE), ("real", VERMILION)):
        for y, result in drawn_results(axes, board, set_name):
            bars.append((y, result["mean_speed"]["mean"], colour))
    assert_bars(axes, *bars)
    assert {round(bar.get_height(), 9) for bar in axes.patches} == {0.38}


def test_the_chart_marks_failures(axes, board):
    marks = []
    for set_name in SIDES:
        for y, result in drawn_results(axes, board, set_name):
            if share := result["failures"] / result["episodes"]:
                x = max(result["mean_speed"]["mean"], 0.0) + 0.15
                marks.append((f"{100.0 * share:.0f} % failed", x, y))
    assert [(text.get_text(), *text.xy) for text in axes.texts] == marks
    assert len(marks) > 1


def test_the_chart_names_its_groups_and_sets(axes, board):
    titles = (tick for tick in axes.get_yticklabels() if tick.get_fontweight() == "bold")
    assert texts(titles) == list(grouped(board))
    labels = texts(axes.figure.legends[0].texts)
    assert [label.partition(":")[0] for label in labels] == ["paper", "real"]
    assert axes.get_xlabel() == "mean speed (cm/s)"


def test_the_chart_shows_whole_bars(axes):
    lowest, highest = axes.get_ylim()
    assert lowest > len(axes.get_yticks()) - 1.0 + 0.38
    assert highest < -0.38
    assert axes.get_xlim()[0] == 0.0
