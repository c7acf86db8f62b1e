"""Figures of a report, narrow enough for a telephone: a panel per policy, no colour per policy."""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agents.analysis.data import SPEED, Results
from agents.analysis.figures import panels, plot_learning, plot_profiles, plot_transport
from agents.leaderboard.rows import Row
from baselines.drawing import VERMILION, new_figure, style
from capsule_gym.evaluation_sets import EvaluationSet

WIDTH, COLUMNS = 4.2, 2
LABELS = {"size": 8.0}
# Letters of a title that fit above a panel, with the blanks that break it behind its hyphens.
TITLE = 28


def to_svg(draw: Callable[..., Any], name: str, *arguments: Any) -> str:
    """A figure as SVG for an HTML page: scaled by its style, with ids that begin with its name.

    Args:
        draw: draws it.
        name: unique in the page.
        arguments: of `draw`.
    """
    content = io.StringIO()
    with style():
        draw(*arguments).savefig(content, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r' (?:width|height)="[\d.]+pt"', "", svg, count=2)
    # A hundredth of a point is enough, but not for a scale, which sizes the letters.
    svg = re.sub(r"(scale\([^)]*\))|\d+\.\d{3,}", lambda found: found[1] or f"{float(found[0]):.2f}", svg)
    return re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{name}-", svg)


def broken(name: str) -> str:
    """A name in lines that fit a panel, broken behind hyphens: the name of a run contains its date."""
    return "\n".join(textwrap.wrap(name.replace("-", "- "), TITLE)).replace("- ", "-")


def _panels(names: Sequence[str], top: float, x: str, y: str) -> tuple[Any, Any]:
    figure, places = panels([broken(name) for name in names], top, columns=COLUMNS, height=1.5, width=WIDTH)
    figure.supxlabel(x, **LABELS)
    figure.supylabel(y, **LABELS)
    return figure, places


def draw_learning(results: Results) -> Any:
    """Mean speed on validation plants over the steps of training."""
    figure, places = _panels(list(results.learning), 0.3, "steps (millions)", "mean speed (cm/s)")
    plot_learning(places, list(results.learning.values()))
    return figure


def draw_profiles(results: Results) -> Any:
    """The share of episodes that are faster than a speed."""
    figure, places = _panels([row.name for row in results.rows], 0.6, "mean speed (cm/s)", "share of episodes")
    plot_profiles(places, results.rows, results.shown_sets, 61, resamples=1000)
    return figure


def draw_transport(rows: Sequence[Row]) -> Any:
    """Speed against cost of transport on the nominal plant."""
    figure = new_figure(max(3.4, 1.4 + 0.145 * len(rows)), WIDTH)
    # Room for the labels on the right, whose width the layout underestimates.
    figure.get_layout_engine().set(rect=(0.0, 0.0, 0.97, 1.0))
    plot_transport(figure, rows, 2)
    return figure


def draw_plants(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> Any:
    """The mean speed on every plant with constant parameters, and where episodes fail."""
    constant = [each for each in sets if not any(plant.changes for plant in each.plants)]
    M, mu = (np.array([getattr(plant, name) for each in constant for plant in each.plants]) for name in ("M", "mu"))
    speeds, failed = (
        {row.name: np.concatenate([row.score(each.name, metric).mean(axis=0) for each in constant]) for row in rows}
        for metric in (SPEED, "failed")
    )
    top = max(1e-9, *(float(values.max()) for values in speeds.values()))
    names = [row.name for row in rows]
    figure, places = _panels(names, 0.6, "mass of the platform M (kg)", "friction coefficient μ")
    used = []
    for name, axes in zip(names, places, strict=False):
        marks = axes.scatter(M, mu, c=speeds[name], s=9.0, vmin=0.0, vmax=top, linewidths=0.0)
        lost = failed[name] > 0.0
        axes.plot(M[lost], mu[lost], "x", color=VERMILION, markersize=4.5, markeredgewidth=0.9)
        axes.set_yscale("log")
        used.append(axes)
    # Parts of the height of all panels.
    thin = 1.0 / math.ceil(len(rows) / COLUMNS)
    size = {"aspect": 40.0, "shrink": 0.6, "fraction": 0.15 * thin, "pad": 0.16 * thin}
    figure.colorbar(marks, ax=used, location="top", **size).set_label("mean speed (cm/s)", **LABELS)
    return figure
