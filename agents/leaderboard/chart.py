"""The chart of the main table: bars of the mean speeds on `paper` and `real`, with shares of failed episodes."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

from agents.leaderboard.page import RANKING_SET, REAL, SPEED, grouped
from baselines.drawing import BLUE, INK, VERMILION, new_figure, style
from capsule_gym.files import canonical_hash

FILE = "docs/media/leaderboard.svg"
BARS = {
    RANKING_SET: (BLUE, "paper: perfect sensors, the plants that models assume"),
    REAL: (VERMILION, "real: noise, bias and latency of sensors, lag and friction of the motor"),
}
WIDTH, LINE, BAR = 5.0, 0.19, 0.38
# Smallest share of failed episodes that is marked.
MARKED = 0.005


def contents(board: Mapping[str, Any]) -> list[tuple[str, list[list[float]]]]:
    """The lines of the chart: titles of groups, and policies, each with mean speed (cm/s) and share of failures."""
    found: list[tuple[str, list[list[float]]]] = []
    for title, rows in grouped(board).items():
        found.append((title, []))
        for row in rows:
            results = [row["results"][name] for name in BARS if name in row["results"]]
            bars = [[each[SPEED.name]["mean"], each["failures"] / each["episodes"]] for each in results]
            found.append((row["policy"], bars))
    return found


def digest(board: Mapping[str, Any]) -> str:
    """The hash of what the chart shows, which its file contains: outlines differ between versions of matplotlib."""
    return canonical_hash(contents(board))


def draw(board: Mapping[str, Any]) -> bytes:
    """The chart as SVG; the same numbers give the same bytes with the same version of matplotlib."""
    lines, content = contents(board), io.BytesIO()
    with style():
        figure = new_figure(0.75 + LINE * len(lines), WIDTH)
        axes = figure.subplots()
        for n, (colour, label) in enumerate(BARS.values()):
            bars = [(y + (n - 0.5) * BAR, *bars[n]) for y, (_, bars) in enumerate(lines) if len(bars) > n]
            axes.barh([y for y, *_ in bars], [speed for _, speed, _ in bars], BAR, color=colour, label=label)
            for y, speed, failed in bars:
                if failed >= MARKED:
                    place = (max(speed, 0.0) + 0.15, y)
                    axes.annotate(f"× {100.0 * failed:.0f} %", place, va="center_baseline", fontsize=6.5, color=INK)
        axes.set_yticks(range(len(lines)), [label for label, _ in lines])
        for text, (_, bars) in zip(axes.get_yticklabels(), lines, strict=True):
            text.set_fontweight("normal" if bars else "bold")
        axes.set(xlabel="mean speed (cm/s); × marks failed episodes", ylim=(len(lines) - 0.4, -0.4))
        axes.tick_params(axis="y", length=0.0)
        axes.grid(visible=False, axis="y")
        figure.legend(loc="outside upper left")
        figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None, "Description": digest(board)})
    return content.getvalue()
