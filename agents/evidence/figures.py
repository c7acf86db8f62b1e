"""The figures of the evidence, readable with a dozen rows and more: a panel or a line each, no colour per policy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.statistics import Curve, estimate
from agents.evidence.material import (
    BASE,
    REFERENCES,
    SPEED,
    Evidence,
    Learning,
    difference,
    fronts,
    improvements,
    profile,
)
from agents.leaderboard.rows import Row
from baselines.drawing import BLUE, GREEN, INK, MUTED, VERMILION, WIDTH, Pen, add_note, new_figure, save, style

COLUMNS = 4
PANEL_HEIGHT = 1.3
# By the order of the sets shown.
PENS = (Pen(BLUE), Pen(VERMILION, (0.0, (5.0, 1.6))))
FRONTS = (Pen(MUTED), Pen(GREEN, (0.0, (5.0, 1.6))))
FAINT = "#c5ccd6"
# Between the labels beside a scatter, in parts of its height.
LABEL_SPACING = 0.048


def draw_all(evidence: Evidence, folder: Path) -> list[Path]:
    """Draws every figure that there is material for.

    Args:
        evidence: what is shown.
        folder: where; must exist.

    Returns:
        The files, `evidence_*.png` and `.svg`.
    """
    figures: dict[str, Callable[[Evidence], Any]] = {"transport": draw_transport}
    if evidence.trained:
        figures |= {"profiles": draw_profiles, "differences": draw_differences}
    if len(evidence.trained) > 1:
        figures |= {"improvement": draw_improvement}
    if evidence.learning:
        figures |= {"learning": draw_learning}
    written = []
    with style():
        for name, draw in figures.items():
            written += save(draw(evidence), folder / f"evidence_{name}")
    return written


def panels(
    names: Sequence[str], top: float, *, columns: int = COLUMNS, height: float = PANEL_HEIGHT, width: float = WIDTH
) -> tuple[Any, Iterator[Any]]:
    """A figure with a panel per name, all with the same axes, and the panels in order.

    Args:
        names: the panels' titles.
        top: height of what stands outside of the panels, in.
        columns: the most panels side by side.
        height: of a line of panels, in.
        width: of the figure, in.
    """
    columns = min(columns, len(names))
    lines = math.ceil(len(names) / columns)
    figure = new_figure(top + height * lines, width)
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(grid.flat, names, strict=False):
        axes.set_title(name)
    for n in range(len(names), grid.size):
        grid.flat[n].set_visible(False)
        # What stands above an empty place has the axis' numbers.
        grid.flat[n - columns].tick_params(labelbottom=True)
    return figure, iter(grid.flat)


def draw_profiles(evidence: Evidence) -> Any:
    """The share of episodes faster than a speed, a panel per trained row."""
    fastest = max(float(row.score(name, SPEED).max()) for row in evidence.trained for name in evidence.shown_sets)
    figure, places = panels([row.name for row in evidence.trained], 0.9)
    for row, axes in zip(evidence.trained, places, strict=False):
        for set_name, pen in zip(evidence.shown_sets, PENS, strict=False):
            plot_curve(axes, profile(row, set_name, fastest), pen, label=f"on {set_name}")
        axes.set(xlim=(0.0, fastest), ylim=(0.0, 1.02))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    figure.supylabel("share of episodes that are faster", fontsize=8.0)
    add_note(
        figure,
        "Horizontal: mean speed (cm/s). All episodes of all training seeds; bands: 95 %, whole seeds resampled. A step "
        "is a policy that makes one speed on all plants; what is missing at the left edge made no progress.",
    )
    return figure


def plot_curve(axes: Any, curve: Curve, pen: Pen, **more: Any) -> None:
    """A curve on its band."""
    axes.fill_between(curve.x, curve.low, curve.high, color=pen.colour, alpha=0.18, linewidth=0.0)
    axes.plot(curve.x, curve.value, **pen.line(**more))


def plot_learning(axes: Any, learning: Learning) -> None:
    """The speeds of all seeds over millions of steps, and their interquartile mean."""
    for steps, speeds in learning.seeds.values():
        # A run that was evaluated once is a point.
        axes.plot(steps / 1e6, speeds, "." if len(speeds) == 1 else "-", color=MUTED, linewidth=0.5, alpha=0.6)
    plot_curve(axes, replace(learning.curve, x=learning.curve.x / 1e6), PENS[0])


def draw_learning(evidence: Evidence) -> Any:
    """Mean speed on own draws over the steps of training, a panel per row."""
    figure, places = panels(list(evidence.learning), 0.75)
    for learning, axes in zip(evidence.learning.values(), places, strict=False):
        plot_learning(axes, learning)
    axes.set(xlim=(0.0, None), ylim=(0.0, None))
    figure.supylabel("mean speed (cm/s)", fontsize=8.0)
    add_note(
        figure,
        "Horizontal: millions of agent steps. Evaluations on each run's own draws, never on a frozen set; grey: the "
        "training seeds; blue: their interquartile mean, band: 95 %.",
    )
    return figure


def draw_differences(evidence: Evidence) -> Any:
    """The paired differences of speed to the references, a line per trained row."""
    rows = evidence.trained
    shown = [name for name in REFERENCES if any(evidence.reference(row, name) for row in rows)]
    figure = new_figure(1.0 + 0.3 * len(rows))
    grid = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    places = -np.arange(len(rows), dtype=np.float64)
    for axes, name in zip(grid, shown, strict=True):
        for k, (set_name, pen) in enumerate(zip(evidence.shown_sets, PENS, strict=False)):
            for row, place in zip(rows, places, strict=True):
                other = evidence.reference(row, name)
                if other is None:
                    continue
                found = difference(row, other, set_name)
                height = place + 0.14 - 0.28 * k
                axes.plot([found.low, found.high], [height] * 2, color=pen.colour, linewidth=1.6)
                axes.plot(found.value, height, "os"[k % 2], color=pen.colour, markersize=3.5)
            axes.plot([], [], "os"[k % 2] + "-", color=pen.colour, markersize=3.5, label=f"on {set_name}")
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.set_title("minus its base" if name == BASE else f"minus {name}")
        axes.set_xlabel("mean speed (cm/s)")
    grid[0].set_yticks(places, [row.name for row in rows])
    grid[0].set_ylim(places[-1] - 0.6, 0.6)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    add_note(
        figure,
        "Interquartile means of the differences episode by episode, with 95 % intervals over training seeds. The base "
        "of a residual is its law alone; a policy that commands the whole torque has none.",
    )
    return figure


def draw_improvement(evidence: Evidence) -> Any:
    """The probability that one policy is faster than another on the same episode: a triangle of a matrix per set."""
    names = [row.name for row in evidence.trained]
    count = len(names)
    above, below = evidence.shown_sets[0], evidence.shown_sets[-1]
    found = {name: improvements(evidence.trained, name) for name in (above, below)}
    figure = new_figure(2.2 + 0.27 * count)
    axes = figure.subplots()
    values = np.full((count, count), np.nan)
    for i, name in enumerate(names):
        for j, other in enumerate(names):
            if i == j:
                continue
            each = found[above if j > i else below][name, other]
            values[i, j] = each.value
            text = f"({each.value:.2f})" if each.low <= 0.5 <= each.high else f"{each.value:.2f}"
            axes.text(j, i, text, ha="center", va="center", fontsize=7.0, color=INK)
    # Wider than the values: the colours stay pale enough for the numbers.
    axes.imshow(values, vmin=-0.4, vmax=1.4, cmap="PuOr_r", aspect="auto")
    axes.plot([-0.5, count - 0.5], [-0.5, count - 0.5], color=INK, linewidth=0.8)
    axes.set_title(f"Probability of improvement: above the diagonal on {above}, below it on {below}")
    axes.set_yticks(range(count), names)
    axes.set_xticks(range(count), names, rotation=40.0, ha="right", rotation_mode="anchor")
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0.0)
    add_note(
        figure,
        "How probable it is that the policy of the line is faster than that of the column on the same episode, over "
        "all pairs of their training seeds. In brackets: the 95 % interval over seeds holds 0.5.",
    )
    return figure


def plot_fronts(axes: Any) -> None:
    """The fronts of what is known of the nominal plant, cost of transport across and mean speed up."""
    for (name, points), pen in zip(fronts().items(), FRONTS, strict=True):
        x, y = zip(*points, strict=True)
        axes.plot(x, y, **pen.line(marker=".", markersize=4.0, linewidth=1.0, label=f"front of the {name}"))


def plot_transport(axes: Any, rows: Sequence[Row]) -> list[str]:
    """Speed against cost of transport on the nominal plant, with the fronts of what is known.

    Args:
        axes: where.
        rows: one or more.

    Returns:
        The names of the rows that make no progress, and so have no place.
    """
    plot_fronts(axes)
    marks, absent = [], []
    for row in rows:
        cost = estimate(row.score("nominal", "cost_of_transport"))
        speed = estimate(row.score("nominal", SPEED))
        if not math.isfinite(cost.value):
            absent.append(row.name)
            continue
        colour = BLUE if row.trained else INK
        if row.trained and all(math.isfinite(end) for end in (cost.low, cost.high, speed.low, speed.high)):
            axes.plot([cost.low, cost.high], [speed.value] * 2, color=colour, linewidth=0.9)
            axes.plot([cost.value] * 2, [speed.low, speed.high], color=colour, linewidth=0.9)
        axes.plot(cost.value, speed.value, "o" if row.trained else "s", color=colour, markersize=4.0)
        marks.append((cost.value, speed.value, row.name, colour))
    axes.plot([], [], "o-", color=BLUE, markersize=4.0, linewidth=0.9, label="trained, 95 % over seeds")
    axes.plot([], [], "s", color=INK, markersize=4.0, label="scripted")
    axes.set(xlabel="cost of transport", ylabel="mean speed (cm/s)", xlim=(0.0, None), ylim=(-0.5, None))
    if marks:
        _label_beside(axes, marks)
    return absent


def draw_transport(evidence: Evidence) -> Any:
    """Speed against cost of transport of all rows, with the fronts of what is known, on the nominal plant."""
    figure = new_figure(max(4.4, 1.4 + 0.145 * len(evidence.rows)))
    # Room for the names on the right, which the layout takes for a little shorter than they are.
    figure.get_layout_engine().set(rect=(0.0, 0.0, 0.985, 1.0))
    axes = figure.subplots()
    absent = plot_transport(axes, evidence.rows)
    axes.set_title("Speed against cost of transport, the paper's plant from 100 starts")
    # Above the axes: inside, every corner has a front, a policy or a line to its name.
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    no_progress = f" Without forward progress, and so without a cost: {', '.join(absent)}." if absent else ""
    add_note(
        figure,
        "Interquartile means over all episodes on nominal. The fronts hold one start, from rest over 33 s: gaits that "
        f"a search found, none both slower and dearer than another.{no_progress}",
    )
    return figure


def _label_beside(axes: Any, marks: Sequence[tuple[float, float, str, str]]) -> None:
    """Names beside the axes in the order of the heights, with a thin line to each mark: none lies on another."""
    from matplotlib.patches import ConnectionPatch

    low, high = axes.get_ylim()
    heights = [(y - low) / (high - low) for _, y, _, _ in marks]
    places = _spread(heights, min(LABEL_SPACING, 1.0 / len(marks)))
    for (x, y, name, colour), place in zip(marks, places.tolist(), strict=True):
        axes.annotate(
            name,
            (1.0, place),
            xycoords="axes fraction",
            xytext=(4.0, 0.0),
            textcoords="offset points",
            va="center",
            fontsize=7.5,
            color=colour,
        )
        line = ConnectionPatch((x, y), (1.0, place), "data", "axes fraction", axesA=axes, color=FAINT, linewidth=0.6)
        line.set_in_layout(False)
        axes.add_artist(line)


def _spread(heights: Sequence[float], spacing: float) -> np.ndarray:
    """Places near the heights, in their order, at least the spacing apart and within 0 to 1 where there is room.

    >>> _spread([0.5, 0.5, 0.9], 0.25).tolist()
    [0.375, 0.625, 0.9]
    """
    order = np.argsort(heights, kind="stable")
    steps = spacing * np.arange(len(order))
    # Less these steps, the places are the nearest that do not fall: means of the pools that adjacent violators form.
    pools: list[list[float]] = []
    for height in (np.asarray(heights)[order] - steps).tolist():
        pools.append([height])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            pools[-2:] = [pools[-2] + pools[-1]]
    level = np.array([np.mean(pool) for pool in pools for _ in pool])
    places = np.empty(len(order))
    places[order] = np.clip(level, 0.0, max(0.0, 1.0 - steps[-1])) + steps
    return places
