"""The chart of the main table: bars of the mean speeds on `paper` and `real`, with shares of failed
episodes.
"""

import io
import textwrap
from collections.abc import Mapping
from typing import Any

from agents.leaderboard.page import RANKING_SET, REAL, SPEED, grouped
from baselines.drawing import BLUE, VERMILION, new_figure, style
from capsule_gym.files import canonical_hash

CHART = "docs/media/leaderboard.svg"
BARS = {
    RANKING_SET: (BLUE, "paper: perfect sensors, the plants that models assume"),
    REAL: (VERMILION, "real: noise, bias and latency of sensors, lag and friction of the motor"),
}
WIDTH, LINE, BAR, LABEL_COLUMNS = 5.0, 0.19, 0.38, 22
# Smallest share of failed episodes that is marked.
MARKED = 0.005


def contents(board: Mapping[str, Any]) -> list[tuple[str, list[list[float]]]]:
    """The lines of the chart: titles of groups, and policies with mean speed (cm/s) and share of
    failures by set.
    """
    found: list[tuple[str, list[list[float]]]] = []
    for title, rows in grouped(board).items():
        found.append((title, []))
        for row in rows:
            results = [row["results"][name] for name in BARS]
            bars = [
                [each[SPEED.name]["mean"], each["failures"] / each["episodes"]] for each in results
            ]
            found.append((row["policy"], bars))
    return found


def digest(board: Mapping[str, Any]) -> str:
    """The hash of what the chart shows, which its file contains: outlines differ between versions
    of matplotlib.
    """
    return canonical_hash(contents(board))


def draw(board: Mapping[str, Any]) -> str:
    """The chart as SVG; the same numbers give the same bytes with the same version of
    matplotlib.
    """
    lines, content = contents(board), io.StringIO()
    with style():
        figure = new_figure(0.75 + LINE * len(lines), WIDTH)
        axes = figure.subplots()
        for n, (colour, label) in enumerate(BARS.values()):
            bars = [(y + (n - 0.5) * BAR, *bars[n]) for y, (_, bars) in enumerate(lines) if bars]
            axes.barh(
                [y for y, *_ in bars],
                [speed for _, speed, _ in bars],
                BAR,
                color=colour,
                label=label,
            )
            for y, speed, failed in (bar for bar in bars if bar[2] >= MARKED):
                text = f"\N{MULTIPLICATION SIGN} {100.0 * failed:.0f} %"
                axes.annotate(
                    text, (max(speed, 0.0) + 0.15, y), va="center_baseline", fontsize="small"
                )
        axes.set_yticks(
            range(len(lines)), [textwrap.fill(label, LABEL_COLUMNS) for label, _ in lines]
        )
        for tick, (_, shown) in zip(axes.get_yticklabels(), lines, strict=True):
            tick.set_fontweight("normal" if shown else "bold")
        axes.set(
            xlabel="mean speed (cm/s); \N{MULTIPLICATION SIGN} failed episodes",
            ylim=(len(lines) - 0.4, -0.4),
        )
        axes.set_xlim(left=0.0)
        axes.grid(visible=False, axis="y")
        figure.legend(loc="outside upper left")
        figure.savefig(
            content,
            format="svg",
            metadata={"Date": None, "Creator": None, "Description": digest(board)},
        )
    return content.getvalue()
