"""The figures of a report, narrow enough for a telephone: a panel per policy, no colour per policy."""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agents.evaluation.statistics import performance_profile
from agents.evidence.figures import PENS, panels, plot_curve, plot_learning, plot_transport
from agents.evidence.material import SPEED, Evidence
from agents.leaderboard.rows import Row
from baselines.drawing import VERMILION, new_figure, style
from capsule_gym.evaluation_sets import EvaluationSet

WIDTH, COLUMNS, PANEL_HEIGHT = 4.2, 2, 1.5
PROFILE_POINTS, PROFILE_RESAMPLES = 61, 1000
LABELS = {"size": 8.0}
# Letters of a title that fit above a panel, with the blanks that are put behind its hyphens to break it there.
TITLE = 28


def draw(figure_of: Callable[..., Any], name: str, *arguments: Any) -> str:
    """A figure as SVG to be put into a page: scaled by its style, its ids like those of no other figure.

    Args:
        figure_of: draws it.
        name: begins its ids.
        arguments: of `figure_of`.
    """
    content = io.StringIO()
    with style():
        figure_of(*arguments).savefig(content, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r' (?:width|height)="[\d.]+pt"', "", svg, count=2)
    # A hundredth of a point is enough; not of a scale, by which letters would outgrow their distances.
    svg = re.sub(r"(scale\([^)]*\))|\d+\.\d{3,}", lambda found: found[1] or f"{float(found[0]):.2f}", svg)
    return re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{name}-", svg)


def _panels(names: Sequence[str], top: float) -> tuple[Any, Any]:
    return panels([_broken(name) for name in names], top, columns=COLUMNS, height=PANEL_HEIGHT, width=WIDTH)


def _broken(name: str) -> str:
    """A name in lines that fit a panel, broken behind hyphens: a run's has its date in it."""
    return "\n".join(textwrap.wrap(name.replace("-", "- "), TITLE)).replace("- ", "-")


def learning(evidence: Evidence) -> Any:
    """Mean speed on own draws over the steps of training."""
    figure, places = _panels(list(evidence.learning), 0.3)
    for each, axes in zip(evidence.learning.values(), places, strict=False):
        plot_learning(axes, each)
    axes.set(xlim=(0.0, None), ylim=(0.0, None))
    figure.supxlabel("steps (millions)", **LABELS)
    figure.supylabel("mean speed (cm/s)", **LABELS)
    return figure


def profiles(rows: Sequence[Row], set_names: Sequence[str]) -> Any:
    """The share of episodes that are faster than a speed."""
    speeds = np.linspace(0.0, max(row.score(name, SPEED).max() for row in rows for name in set_names), PROFILE_POINTS)
    figure, places = _panels([row.name for row in rows], 0.6)
    for row, axes in zip(rows, places, strict=False):
        for name, pen in zip(set_names, PENS, strict=False):
            curve = performance_profile(row.score(name, SPEED), speeds, resamples=PROFILE_RESAMPLES)
            plot_curve(axes, curve, pen, label=f"on {name}")
        axes.set(xlim=(0.0, speeds[-1]), ylim=(0.0, 1.02))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    figure.supxlabel("mean speed (cm/s)", **LABELS)
    figure.supylabel("share of episodes", **LABELS)
    return figure


def transport(rows: Sequence[Row]) -> Any:
    """Speed against cost of transport on the nominal plant."""
    figure = new_figure(max(3.4, 1.4 + 0.145 * len(rows)), WIDTH)
    # Room for the names on the right, which the layout takes for a little shorter than they are.
    figure.get_layout_engine().set(rect=(0.0, 0.0, 0.97, 1.0))
    axes = figure.subplots()
    plot_transport(axes, rows)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def plants(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> Any:
    """The mean speed on every plant that stays what it is, and where episodes fail."""
    still = [each for each in sets if not any(plant.changes for plant in each.plants)]
    M, mu = (np.array([getattr(plant, name) for each in still for plant in each.plants]) for name in ("M", "mu"))
    speeds, failed = (
        {row.name: np.concatenate([row.score(each.name, name).mean(axis=0) for each in still]) for row in rows}
        for name in (SPEED, "failed")
    )
    top = max(float(values.max()) for values in speeds.values())
    figure, places = _panels([row.name for row in rows], 0.6)
    used = []
    for row, axes in zip(rows, places, strict=False):
        marks = axes.scatter(M, mu, c=speeds[row.name], s=9.0, vmin=0.0, vmax=max(top, 1e-9), linewidths=0.0)
        lost = failed[row.name] > 0.0
        axes.plot(M[lost], mu[lost], "x", color=VERMILION, markersize=4.5, markeredgewidth=0.9)
        axes.set_yscale("log")
        used.append(axes)
    # Parts of the height of all panels.
    thin = 1.0 / math.ceil(len(rows) / COLUMNS)
    bar = figure.colorbar(
        marks, ax=used, location="top", aspect=40.0, shrink=0.6, fraction=0.15 * thin, pad=0.16 * thin
    )
    bar.set_label("mean speed (cm/s)", **LABELS)
    figure.supxlabel("mass of the platform M (kg)", **LABELS)
    figure.supylabel("friction coefficient μ", **LABELS)
    return figure
