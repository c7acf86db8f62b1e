"""The chart of the main table: mean speeds and shares of failed episodes on `paper` and `real`."""

import io

from agents.leaderboard.page import RANKING_SET, REAL, SPEED, Board, grouped
from baselines.drawing import BLUE, VERMILION, new_figure, style
from capsule_gym.files import canonical_hash

CHART = "docs/media/leaderboard.svg"
BARS = {
    RANKING_SET: (BLUE, "paper: perfect sensors, the plants that models assume"),
    REAL: (VERMILION, "real: noise, bias and latency of sensors, lag and friction of the motor"),
}
# Width of the figure and height of a line, in.
WIDTH = 6.0
LINE_HEIGHT = 0.19
# Thickness of a bar, in lines.
BAR = 0.38
# Distance of a mark from its bar, cm/s.
MARK_DISTANCE = 0.15
# Smallest share of failed episodes that is marked.
MARKED = 0.005


def contents(board: Board) -> list[tuple[str, list[tuple[float, float]]]]:
    """The lines of the chart: titles of groups, and policies with their bars.

    A bar is the mean speed (cm/s) and the share of failed episodes on a set.
    """
    found: list[tuple[str, list[tuple[float, float]]]] = []
    for title, rows in grouped(board).items():
        found.append((title, []))
        for row in rows:
            bars = []
            for set_name in BARS:
                result = row["results"][set_name]
                failed = result["failures"] / result["episodes"]
                bars.append((result[SPEED.name]["mean"], failed))
            found.append((row["policy"], bars))
    return found


def digest(board: Board) -> str:
    """The hash of what the chart shows, which its file contains.

    The file's outlines differ between versions of matplotlib.
    """
    return canonical_hash(contents(board))


def draw(board: Board) -> str:
    """The chart as SVG; equal numbers give equal bytes with the same version of matplotlib."""
    lines = contents(board)
    with style():
        figure = new_figure(0.75 + LINE_HEIGHT * len(lines), WIDTH)
        axes = figure.subplots()
        for n, (colour, label) in enumerate(BARS.values()):
            # The bar of the first set is above the middle of its line, the other one below.
            offset = (n - 0.5) * BAR
            bars = {y + offset: bars[n] for y, (_, bars) in enumerate(lines) if bars}
            speeds = [speed for speed, _ in bars.values()]
            axes.barh(list(bars), speeds, BAR, color=colour, label=label)
            for y, (speed, failed) in bars.items():
                if failed >= MARKED:
                    text = f"{100.0 * failed:.0f} % failed"
                    place = (max(speed, 0.0) + MARK_DISTANCE, y)
                    axes.annotate(text, place, va="center_baseline", fontsize="small")
        names = [label for label, _ in lines]
        axes.set_yticks(range(len(lines)), names)
        for tick, (_, shown) in zip(axes.get_yticklabels(), lines, strict=True):
            tick.set_fontweight("normal" if shown else "bold")
        axes.set_xlabel("mean speed (cm/s)")
        axes.set_xlim(left=0.0)
        axes.set_ylim(len(lines) - 0.4, -0.4)
        axes.grid(visible=False, axis="y")
        figure.legend(loc="outside upper left")
        content = io.StringIO()
        metadata = {"Date": None, "Creator": None, "Description": digest(board)}
        figure.savefig(content, format="svg", metadata=metadata)
    return content.getvalue()
