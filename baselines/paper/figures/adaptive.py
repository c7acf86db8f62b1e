"""Figures 6 to 9 of the paper: the adaptive law (39) on three plants, regularised, and corrected only.

The paper's own curves are not available as data. What can be compared is the numbers and the words of its text.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.drawing import GREEN, INK, MUTED, PURPLE, REFERENCE, Pen, add_note, mark_published, new_figure
from baselines.laws.adaptive import adaptive, adaptive_as_published
from baselines.laws.gains import PUBLISHED
from baselines.laws.profiles import PROPOSED
from baselines.paper import published
from baselines.paper.adaptive_study import CORRECTED_LAW, REGULARISED_LAW
from baselines.paper.traces import CYCLES, Trace, traces
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import TORQUE_LIMIT

Quantity = Callable[[Trace], np.ndarray]

# Nominal, lightest with least friction, heaviest with most: the ends of the paper's ranges.
PLANTS = ((NOMINAL.M, NOMINAL.mu), *zip(published.M_RANGE, published.MU_RANGE, strict=True))
PLANT_PENS = (Pen(INK), Pen(GREEN, (0.0, (5.0, 1.6))), Pen(PURPLE, (0.0, (2.5, 1.2))))
# Five cycles, s.
WHOLE = CYCLES * PROPOSED.period
# The first swing, s.
FIRST_SWING = 0.9
# Long enough to see what the unregularised law does, short enough to see its chattering as such; s.
CHATTER = 0.3


@dataclass(frozen=True)
class AdaptiveRuns:
    """Runs of the adaptive law on each of PLANTS, five cycles from rest, with the environment's torque limit.

    Attributes:
        regularised: the default.
        corrected: corrected, unregularised.
    """

    regularised: Sequence[Trace]
    corrected: Sequence[Trace]


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
    return ((REGULARISED_LAW, runs.regularised), (CORRECTED_LAW, runs.corrected))


def _ends(series: Sequence[Trace]) -> str:
    """When runs lost contact, in words."""
    ended = [f"at {run.t[-1]:.2f} s" for run in series if not run.completed]
    if not ended:
        return "all runs last"
    lose = "loses" if len(ended) == 1 else "lose"
    return f"{len(ended)} of {len(series)} runs {lose} contact with the floor, {' and '.join(ended)} (cross)"


def _draw_runs(axes: Any, series: Sequence[Trace], quantity: Quantity, *, first_on_top: bool = False) -> None:
    """A quantity on the three plants, with a cross where a run ends early."""
    for i, (run, plant, pen) in enumerate(zip(series, PLANTS, PLANT_PENS, strict=True)):
        values = quantity(run)
        zorder = 2.0 + (-0.1 if first_on_top else 0.1) * i
        axes.plot(run.t, values, **pen.line(label=_plant_label(plant), lw=1.1, zorder=zorder))
        if not run.completed:
            axes.plot(run.t[-1], values[-1], "x", color=pen.colour, ms=6, mew=1.6, clip_on=False, zorder=5)


def draw_adaptive_tracking(runs: AdaptiveRuns) -> Any:
    """Fig. 6: rate and angle under the adaptive law (39), over the whole run and in the first swing."""
    stated = published.ADAPTIVE_PEAK_VELOCITY.value
    figure = new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    rates, angles = np.arange(0.0, 9.0, 2.0), np.arange(-60.0, 90.0, 30.0)
    # The room above the curves is the insets'.
    rows: tuple[tuple[Quantity, Quantity, tuple[float, float], np.ndarray], ...] = (
        (lambda run: run.theta_dot, lambda run: run.theta_d_dot, (-1.2, 19.5), rates),
        (lambda run: np.degrees(run.theta), lambda run: np.degrees(run.theta_d), (-68.0, 255.0), angles),
    )
    reference = runs.regularised[0]
    for column, (law, series) in enumerate(_both_laws(runs)):
        for axes, (quantity, target, limits, ticks) in zip(grid[:, column], rows, strict=True):
            inset = axes.inset_axes((0.12, 0.61, 0.85, 0.37))
            for each in (axes, inset):
                each.plot(reference.t, target(reference), **REFERENCE, label="reference")
                _draw_runs(each, series, quantity)
            axes.set(xlim=(0.0, WHOLE), ylim=limits, yticks=ticks)
            inset.set(xlim=(0.0, FIRST_SWING), ylim=(1.15 * min(quantity(reference)), 1.22 * max(quantity(reference))))
            inset.tick_params(labelsize=6.5)
            inset.set_yticks(ticks[::2])
        grid[0][column].set_title(law)
        mark_published(grid[0][column].child_axes[0], stated, f"published largest: {stated:g} rad/s", Pen(INK))
        grid[1][column].set(xlabel="time (s); insets: the first swing")
    grid[0][0].set(title=f"Figure 6: adaptive law (39), {REGULARISED_LAW}", ylabel="rate θ' (rad/s)")
    grid[1][0].set(ylabel="angle θ (deg)")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    peaks = [run.theta_dot.max() for run in runs.regularised]
    add_note(
        figure,
        f"Largest rate, {REGULARISED_LAW}: found {min(peaks):.2f} to {max(peaks):.2f} rad/s, published {stated:g}. "
        f"{CORRECTED_LAW.capitalize()}, with the torque limit of {TORQUE_LIMIT:g} N m: {_ends(runs.corrected)}. The "
        "paper's curves are not available as data.",
    )
    return figure


def _two_panels(
    runs: AdaptiveRuns,
    title: str,
    label: str,
    quantity: Quantity,
    note: str,
    window: float | None = None,
) -> Any:
    """A quantity on the three plants: the regularised law above, the unregularised one below.

    Args:
        runs: the runs.
        title: of the figure.
        label: of the vertical axes.
        quantity: what is drawn.
        note: under the figure.
        window: seconds of the unregularised law's panel; None for all five cycles.
    """
    figure = new_figure(4.3)
    panels = figure.subplots(2, 1, sharex=window is None)
    for axes, end, (law, series) in zip(panels, (WHOLE, window or WHOLE), _both_laws(runs), strict=True):
        for run, plant, pen in zip(series, PLANTS, PLANT_PENS, strict=True):
            values = quantity(run)
            shown = run.t[1:] <= end
            axes.plot(run.t[1:][shown], values[1:][shown], **pen.line(lw=1.0, label=_plant_label(plant)))
            if not run.completed:
                axes.plot(run.t[-1], values[-1], "x", color=pen.colour, ms=6, mew=1.6, clip_on=False, zorder=5)
        axes.set(ylabel=label, xlim=(0.0, end))
        axes.set_title(law if end == WHOLE else f"{law}, the first {end:g} s")
        # The action of a cycle lies in its first second, and the slow return leaves room.
        axes.margins(y=0.08)
    panels[0].set_title(f"{title}, {REGULARISED_LAW}")
    panels[0].legend(loc="upper center", ncols=3, bbox_to_anchor=(0.5, 1.0))
    low, high = panels[0].get_ylim()
    panels[0].set_ylim(low, high + 0.22 * (high - low))
    panels[1].set(xlabel="time (s)")
    add_note(figure, note)
    return figure


def draw_adaptive_error(runs: AdaptiveRuns) -> Any:
    """Fig. 7: the errors of angle and rate under the adaptive law."""
    errors: tuple[tuple[str, Quantity], ...] = (
        (r"angle error $\theta - \theta_d$ (mrad)", lambda run: 1e3 * run.error),
        (r"rate error $\dot\theta - \dot\theta_d$ (mrad/s)", lambda run: 1e3 * run.rate_error),
    )
    figure = new_figure(4.8)
    grid = figure.subplots(2, 2, sharex=True)
    for column, (law, series) in enumerate(_both_laws(runs)):
        for axes, (label, quantity) in zip(grid[:, column], errors, strict=True):
            _draw_runs(axes, series, quantity, first_on_top=True)
            axes.set(xlim=(0.0, WHOLE))
            if column == 0:
                axes.set_ylabel(label)
        grid[0][column].set_title(law)
        grid[1][column].set_xlabel("time (s)")
    grid[0][0].set_title(f"Figure 7: tracking errors, {REGULARISED_LAW}")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    angles, rates = (
        [max(np.abs(quantity(run)).max() for run in series) for _, series in _both_laws(runs)] for _, quantity in errors
    )
    add_note(
        figure,
        f"Largest errors: {REGULARISED_LAW} {angles[0]:.2f} mrad and {rates[0]:.1f} mrad/s; {CORRECTED_LAW} "
        f"{angles[1]:.1f} mrad and {rates[1]:.0f} mrad/s, {_ends(runs.corrected)}. In print: no number, 'tracks the "
        "planned trajectory accurately', 'the angular velocity will eventually converge to zero'. The paper's curves "
        "are not available as data.",
    )
    return figure


def draw_adaptive_torque(runs: AdaptiveRuns) -> Any:
    """Fig. 8: motor torque under the adaptive law."""
    stated = published.PROPOSED["peak_torque"].value
    found = [run.metrics["peak_torque"] for run in runs.regularised]
    note = (
        f"Largest torque: {REGULARISED_LAW} {max(found):.3f} N m. In print: no number here; {stated:g} N m for the law "
        f"(35) on the same profile. {CORRECTED_LAW.capitalize()}, it runs to the limit of {TORQUE_LIMIT:g} N m away "
        f"from the nominal plant, and {_ends(runs.corrected)}. The paper's curves are not available as data."
    )
    figure = _two_panels(
        runs, "Figure 8: torque of the law (39)", "torque u (N m)", lambda run: run.torque, note, CHATTER
    )
    mark_published(figure.axes[0], stated, f"{stated:g} N m", Pen(MUTED))
    return figure


def sliding_variable(run: Trace) -> np.ndarray:
    """delta_theta of (37b), rad/s: the error's rate plus Lambda_theta times the error."""
    return run.rate_error + PUBLISHED.Lambda_theta * run.error


def draw_sliding_variable(runs: AdaptiveRuns) -> Any:
    """Fig. 9: the collocated sliding variable delta_theta."""
    found = [np.abs(sliding_variable(run)).max() for run in runs.regularised]
    note = (
        rf"Largest $|\delta_\theta|$: {REGULARISED_LAW} {1e3 * max(found):.1f} mrad/s. In print: no number, "
        "'convergence towards zero'. It returns towards zero after every progressive stage, and the next cycle excites "
        f"it anew. {CORRECTED_LAW.capitalize()}, {_ends(runs.corrected)}. The paper's curves are not available as data."
    )
    return _two_panels(
        runs,
        r"Figure 9: sliding variable $\delta_\theta$ of (37b)",
        r"$\delta_\theta$ (mrad/s)",
        lambda run: 1e3 * sliding_variable(run),
        note,
        CHATTER,
    )
