"""Figures 6 to 9 of the paper: the adaptive law (39) on three plants, as regularised and as published."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.drawing import GREEN, INK, MUTED, PURPLE, REFERENCE, Pen, add_note, mark_published, new_figure
from baselines.laws.adaptive import adaptive, adaptive_as_published
from baselines.laws.gains import LAMBDA_THETA
from baselines.laws.profiles import PROPOSED
from baselines.paper import published
from baselines.paper.traces import CYCLES, Trace, traces
from capsule_gym.task import TORQUE_LIMIT

# Nominal, lightest with least friction, heaviest with most: the ends of the paper's ranges.
PLANTS = ((0.5, 0.01), (0.45, 0.009), (0.55, 0.011))
PLANT_PENS = (Pen(INK), Pen(GREEN, (0.0, (5.0, 1.6))), Pen(PURPLE, (0.0, (2.5, 1.2))))
# Of the first cycle: the progressive stage and the end of the platform's motion, s.
SHOWN = 1.2
# Long enough to see what the published law does, short enough to see its chattering as such; s.
CHATTER = 0.3


@dataclass(frozen=True)
class AdaptiveRuns:
    """Runs of the adaptive law on each of PLANTS, five cycles from rest, with the environment's torque limit.

    Attributes:
        regularised: the default.
        as_published: the law as printed.
    """

    regularised: Sequence[Trace]
    as_published: Sequence[Trace]


def run_adaptive() -> AdaptiveRuns:
    """Runs both forms of the law."""
    return AdaptiveRuns(
        *(traces(law(), list(PLANTS), torque_limit=TORQUE_LIMIT) for law in (adaptive, adaptive_as_published))
    )


def _plant_label(plant: tuple[float, float]) -> str:
    """M and mu of a plant."""
    return f"M = {plant[0]:g} kg, μ = {plant[1]:g}"


def _both_laws(runs: AdaptiveRuns) -> tuple[tuple[str, Sequence[Trace]], ...]:
    """The two forms of the adaptive law with their titles."""
    return (("regularised", runs.regularised), ("as published", runs.as_published))


def _ends(series: Sequence[Trace]) -> str:
    """When runs lost contact, in words."""
    ended = [f"at {run.t[-1]:.2f} s" for run in series if not run.completed]
    if not ended:
        return "all runs last"
    lose = "loses" if len(ended) == 1 else "lose"
    return f"{len(ended)} of {len(series)} runs {lose} contact with the floor, {' and '.join(ended)} (cross)"


def draw_adaptive_tracking(runs: AdaptiveRuns) -> Any:
    """Fig. 6: rate and angle under the adaptive law (39), as regularised and as published."""
    stated = published.ADAPTIVE_PEAK_VELOCITY.value
    figure = new_figure(4.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (title, series) in enumerate(_both_laws(runs)):
        rate, angle = grid[0][column], grid[1][column]
        reference = runs.regularised[0]
        rate.plot(reference.t, reference.theta_d_dot, **REFERENCE, label="reference")
        angle.plot(reference.t, np.degrees(reference.theta_d), **REFERENCE)
        for run, plant, pen in zip(series, PLANTS, PLANT_PENS, strict=True):
            rate.plot(run.t, run.theta_dot, **pen.line(label=_plant_label(plant)))
            angle.plot(run.t, np.degrees(run.theta), **pen.line())
            if not run.completed:
                rate.plot(run.t[-1], run.theta_dot[-1], "x", color=pen.colour, ms=6, mew=1.6)
                angle.plot(run.t[-1], np.degrees(run.theta[-1]), "x", color=pen.colour, ms=6, mew=1.6)
        rate.set(title=title, xlim=(0.0, SHOWN), ylim=(-1.0, 9.2), xticks=np.arange(0.0, 1.1, 0.2))
        mark_published(rate, stated, f"published largest: {stated:g} rad/s", Pen(INK))
        angle.set(xlabel="time (s)")
    grid[0][0].set(title="Figure 6: adaptive law (39), regularised", ylabel="rate θ' (rad/s)")
    grid[1][0].set(ylabel="angle θ (deg)")
    grid[0][0].legend(loc="center right")
    peaks = [run.theta_dot.max() for run in runs.regularised]
    add_note(
        figure,
        f"Largest rate, regularised: found {min(peaks):.2f} to {max(peaks):.2f} rad/s, published {stated:g}. As "
        f"published, with the torque limit of {TORQUE_LIMIT:g} N m: {_ends(runs.as_published)}.",
    )
    return figure


def _two_panels(
    runs: AdaptiveRuns,
    title: str,
    label: str,
    quantity: Callable[[Trace], np.ndarray],
    note: str,
    window: float | None = None,
) -> Any:
    """A quantity on the three plants: the regularised law above, the published one below.

    Args:
        runs: the runs.
        title: of the figure.
        label: of the vertical axes.
        quantity: what is drawn.
        note: under the figure.
        window: seconds of the published law's panel; None for all five cycles.
    """
    figure = new_figure(4.3)
    panels = figure.subplots(2, 1, sharex=window is None)
    whole = CYCLES * PROPOSED.period
    for axes, end, (law, series) in zip(panels, (whole, window or whole), _both_laws(runs), strict=True):
        for run, plant, pen in zip(series, PLANTS, PLANT_PENS, strict=True):
            values = quantity(run)
            shown = run.t[1:] <= end
            axes.plot(run.t[1:][shown], values[1:][shown], **pen.line(lw=1.0, label=_plant_label(plant)))
            if not run.completed:
                axes.plot(run.t[-1], values[-1], "x", color=pen.colour, ms=6, mew=1.6, clip_on=False, zorder=5)
        axes.set(ylabel=label, xlim=(0.0, end))
        axes.set_title(law if end == whole else f"{law}, the first {end:g} s")
        # The action of a cycle lies in its first second, and the slow return leaves room.
        axes.margins(y=0.08)
    panels[0].set_title(f"{title}, regularised")
    panels[0].legend(loc="upper center", ncols=3, bbox_to_anchor=(0.5, 1.0))
    low, high = panels[0].get_ylim()
    panels[0].set_ylim(low, high + 0.22 * (high - low))
    panels[1].set(xlabel="time (s)")
    add_note(figure, note)
    return figure


def draw_adaptive_error(runs: AdaptiveRuns) -> Any:
    """Fig. 7: the angle's tracking error under the adaptive law."""
    found = [1e3 * np.abs(run.theta - run.theta_d).max() for run in runs.regularised]
    worst = [1e3 * np.abs(run.theta - run.theta_d).max() for run in runs.as_published]
    note = (
        f"Largest error: regularised {max(found):.2f} mrad, as published {max(worst):.1f} mrad. "
        f"In print: no number, 'tracks the planned trajectory accurately'. As published, {_ends(runs.as_published)}."
    )
    return _two_panels(
        runs,
        "Figure 7: tracking error",
        r"error $\theta - \theta_d$ (mrad)",
        lambda run: 1e3 * (run.theta - run.theta_d),
        note,
    )


def draw_adaptive_torque(runs: AdaptiveRuns) -> Any:
    """Fig. 8: motor torque under the adaptive law."""
    stated = published.PROPOSED["peak_torque"].value
    found = [run.metrics["peak_torque"] for run in runs.regularised]
    note = (
        f"Largest torque: regularised {max(found):.3f} N m. In print: no number here; {stated:g} N m for the law (35) "
        f"on the same profile. As published it runs to the limit of {TORQUE_LIMIT:g} N m away from the nominal "
        f"plant, and {_ends(runs.as_published)}."
    )
    figure = _two_panels(
        runs, "Figure 8: torque of the law (39)", "torque u (N m)", lambda run: run.torque, note, CHATTER
    )
    mark_published(figure.axes[0], stated, f"{stated:g} N m", Pen(MUTED))
    return figure


def sliding_variable(run: Trace) -> np.ndarray:
    """delta_theta of (37b), rad/s: the error's rate plus Lambda_theta times the error."""
    return run.theta_dot - run.theta_d_dot + LAMBDA_THETA * (run.theta - run.theta_d)


def draw_sliding_variable(runs: AdaptiveRuns) -> Any:
    """Fig. 9: the collocated sliding variable delta_theta."""
    found = [np.abs(sliding_variable(run)).max() for run in runs.regularised]
    note = (
        rf"Largest $|\delta_\theta|$: regularised {max(found):.3f} rad/s. In print: no number, 'convergence towards "
        "zero'. It returns to zero after every progressive stage, and the next cycle excites it anew. "
        f"As published, {_ends(runs.as_published)}."
    )
    return _two_panels(
        runs,
        r"Figure 9: sliding variable $\delta_\theta$ of (37b)",
        r"$\delta_\theta$ (rad/s)",
        sliding_variable,
        note,
        CHATTER,
    )
