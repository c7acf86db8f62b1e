"""The chart of `python -m benchmarks.throughput`: rates on top, accuracy against cost below."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from baselines import drawing
from benchmarks.contenders import DIRECT, WITH_LAW
from benchmarks.cost import CASES, OURS, Point
from benchmarks.timing import Contender, Rate
from capsule_gym.files import replacing

HEIGHT = 8.2
# Of the PNG: half as many bytes as at the resolution of the paper's figures.
RESOLUTION = 130
PANELS = (1.55, 1.0)
# What a label begins with, the colour of its bars, and the words for it; the last is for all others.
KINDS = (
    (WITH_LAW, "#56B4E9", "ours, the law inside the step"),
    (DIRECT, drawing.BLUE, "ours, direct torque"),
    ("MuJoCo", drawing.VERMILION, "the same capsule in MuJoCo"),
    ("", drawing.MUTED, "other environments"),
)
TWO_THREADS: dict[str, Any] = {"marker": "D", "markersize": 3.2, "color": drawing.INK, "linestyle": "none"}
# Where the numbers beside the bars end, in points right of the axes.
COLUMNS = (34.0, 70.0)
# Ratio of two errors below which their labels would overlap on one side.
CROWDED = 4.0
SERIES = {
    OURS: (drawing.BLUE, "o"),
    "MuJoCo frictionloss": (drawing.VERMILION, "s"),
    "MuJoCo contact": (drawing.GREEN, "^"),
    "MuJoCo contact, stiff": (drawing.PURPLE, "D"),
}


def _colour(contender: Contender) -> str:
    """Ours, MuJoCo's and the others' are told apart."""
    return next(colour for kind, colour, _ in KINDS if contender.label.startswith(kind))


def _draw_rates(axes: Any, contenders: Sequence[Contender], rates: Mapping[str, Rate]) -> None:
    """A bar per contender on one thread, a mark where two threads bring it, and both as numbers."""
    bars = [contender for contender in contenders if contender.threads == 1]
    shared = {(c.label, c.environments): rates[c.name].median for c in contenders if c.threads > 1}
    for row, contender in enumerate(bars):
        rate = rates[contender.name].median
        axes.barh(row, rate, height=0.72, color=_colour(contender), log=True)
        two = shared.get((contender.label, contender.environments))
        if two is not None:
            axes.plot(two, row, **TWO_THREADS)
        for place, value in zip(COLUMNS, (rate, two), strict=True):
            if value is not None:
                _beside(axes, place, row, _short(value))
    for place, head in zip(COLUMNS, ("one\nthread", "two\nthreads"), strict=True):
        if shared or place == COLUMNS[0]:
            _beside(axes, place, -0.75, head, va="bottom")
    names = [f"{c.label}{f' x {c.environments:,}' if c.environments > 1 else ''}" for c in bars]
    axes.set_yticks(range(len(bars)), names, fontsize=6.8)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    medians = [rate.median for rate in rates.values()]
    axes.set_xlim(10.0 ** math.floor(math.log10(min(medians))), 1.6 * max(medians))
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0.0)
    axes.set_xlabel("environment steps per second")
    present = {_colour(contender) for contender in bars}
    for _, colour, words in KINDS:
        if colour in present:
            axes.barh(0, 0.0, color=colour, label=words)
    if shared:
        axes.plot([], [], label="two threads (bars: one)", **TWO_THREADS)
    handles, labels = axes.get_legend_handles_labels()
    # The bars first, then the mark that stands on them.
    order = sorted(range(len(labels)), key=lambda n: labels[n].startswith("two threads"))
    handles, labels = [handles[n] for n in order], [labels[n] for n in order]
    axes.legend(
        handles,
        labels,
        loc="lower right",
        frameon=True,
        facecolor="white",
        edgecolor="none",
        framealpha=1.0,
        fontsize=6.8,
    )


def _beside(axes: Any, place: float, row: float, text: str, **more: Any) -> None:
    """A number right of the axes, in the row of its bar."""
    style = {"ha": "right", "va": "center", "fontsize": 6.5, "color": drawing.INK, **more}
    axes.annotate(
        text, (1.0, row), (place, 0.0), xycoords=axes.get_yaxis_transform(), textcoords="offset points", **style
    )


def _short(rate: float) -> str:
    """A rate with two or three digits."""
    for limit, unit in ((1e6, "M"), (1e3, "k")):
        if rate >= limit:
            return f"{rate / limit:.3g} {unit}"
    return f"{rate:.3g}"


def _draw_cost(axes: Any, points: Sequence[Point]) -> None:
    """Error over cost, a line per model and integrator through its steps."""
    for series in dict.fromkeys(point.series for point in points):
        own = sorted((point for point in points if point.series == series), key=lambda point: point.physics_dt)
        model, _, integrator = series.rpartition(", ") if series != OURS else (OURS, "", "")
        colour, marker = SERIES[model]
        costs, errors = [point.cost for point in own], [point.errors[0] for point in own]
        hollow = {"markerfacecolor": "white", "linestyle": "--"} if integrator == "RK4" else {}
        axes.loglog(costs, errors, marker=marker, markersize=3.6, color=colour, label=series, **hollow)
        for point, above in zip(own, [*errors[1:], math.inf], strict=True) if series == OURS else ():
            # Next to a point that is nearly as accurate the label goes below.
            crowded = above < CROWDED * point.errors[0]
            axes.annotate(
                f"{1e3 * point.physics_dt:g} ms",
                (point.cost, point.errors[0]),
                (5.0, -8.0 if crowded else 2.0),
                textcoords="offset points",
                fontsize=6.5,
                color=colour,
            )
    axes.set_xlabel("microseconds per simulated second and environment, one thread")
    axes.set_ylabel("largest error after 10 s")
    axes.set_title(f"Accuracy against cost, {CASES[0]}; each mark is an integration step")
    axes.legend(loc="best", fontsize=7.0)


def draw(contenders: Sequence[Contender], rates: Mapping[str, Rate], points: Sequence[Point], note: str) -> Any:
    """The figure, to be called in the house style.

    Args:
        contenders: in the order of their bars.
        rates: theirs, by name.
        points: of accuracy against cost.
        note: stands below.
    """
    figure = drawing.new_figure(HEIGHT)
    above, below = figure.subplots(2, 1, height_ratios=PANELS)
    above.set_title("Rates; x 1,024: a batch of that size")
    _draw_rates(above, contenders, rates)
    _draw_cost(below, points)
    drawing.add_note(figure, note)
    return figure


def save(
    path: Path, contenders: Sequence[Contender], rates: Mapping[str, Rate], points: Sequence[Point], note: str
) -> None:
    """Writes the chart as PNG, whole or not at all."""
    with drawing.style():
        figure = draw(contenders, rates, points, note)
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=RESOLUTION, metadata={"Software": None})
