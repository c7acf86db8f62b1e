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

HEIGHT = 8.0
# Of the PNG: half as many bytes as at the resolution of the paper's figures.
RESOLUTION = 130
PANELS = (1.55, 1.0)
COLOURS = {DIRECT: drawing.BLUE, WITH_LAW: "#56B4E9", "MuJoCo": drawing.VERMILION}
TWO_THREADS: dict[str, Any] = {"marker": "D", "markersize": 3.2, "color": drawing.INK, "linestyle": "none"}
SERIES = {
    OURS: (drawing.BLUE, "o"),
    "MuJoCo frictionloss": (drawing.VERMILION, "s"),
    "MuJoCo contact": (drawing.GREEN, "^"),
    "MuJoCo contact, stiff": (drawing.PURPLE, "D"),
}


def _colour(contender: Contender) -> str:
    """Ours, MuJoCo's and the others' are told apart."""
    return next(
        (COLOURS[kind] for kind in (WITH_LAW, DIRECT, "MuJoCo") if contender.label.startswith(kind)), drawing.MUTED
    )


def _draw_rates(axes: Any, contenders: Sequence[Contender], rates: Mapping[str, Rate]) -> None:
    """A bar per contender on one thread; a mark where two threads bring it."""
    bars = [contender for contender in contenders if contender.threads == 1]
    shared = {(c.label, c.environments): rates[c.name].median for c in contenders if c.threads > 1}
    for row, contender in enumerate(bars):
        rate, colour = rates[contender.name].median, _colour(contender)
        axes.barh(row, rate, height=0.72, color=colour, log=True)
        two = shared.get((contender.label, contender.environments))
        if two is not None:
            axes.plot(two, row, **TWO_THREADS)
        axes.annotate(
            _short(rate),
            (max(rate, two or 0.0), row),
            (4.0, 0.0),
            textcoords="offset points",
            va="center",
            fontsize=6.5,
        )
    names = [f"{c.label}{f' x {c.environments:,}' if c.environments > 1 else ''}" for c in bars]
    axes.set_yticks(range(len(bars)), names, fontsize=6.8)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    medians = [rate.median for rate in rates.values()]
    axes.set_xlim(10.0 ** math.floor(math.log10(min(medians))), 5.0 * max(medians))
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0.0)
    axes.set_xlabel("environment steps per second; bars and numbers: one thread")
    if shared:
        axes.plot([], [], label="two threads", **TWO_THREADS)
        axes.legend(loc="lower right")


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
        if series == OURS:
            for point in own:
                axes.annotate(
                    f"{1e3 * point.physics_dt:g} ms",
                    (point.cost, point.errors[0]),
                    (5.0, 2.0),
                    textcoords="offset points",
                    fontsize=6.5,
                    color=colour,
                )
    axes.set_xlabel("microseconds per simulated second and environment, one thread")
    axes.set_ylabel("largest error after 10 s")
    axes.set_title(f"Accuracy against cost, {CASES[0]}")
    axes.legend(loc="best")


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
    above.set_title("Rates; x: size of the batch")
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
