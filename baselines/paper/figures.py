"""Figures 3 to 9 of the paper from our own runs, with the published numbers."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from baselines.drawing import (
    GREEN,
    INK,
    MUTED,
    PENS,
    PUBLISHED_DASHES,
    PURPLE,
    REFERENCE,
    add_note,
    mark_published,
    new_figure,
    save,
    style,
)
from baselines.paper import published
from baselines.paper.adaptive import CORRECTED_LAW, REGULARISED_LAW, sliding
from baselines.paper.tracking import CYCLES, Trajectory, simulate
from capsule_gym.control.controller import LAW_DT
from capsule_gym.control.laws.adaptive import adaptive, adaptive_as_published
from capsule_gym.control.laws.feedback_linearisation import epc, feedback_linearising
from capsule_gym.control.laws.profiles import PROPOSED
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import TORQUE_LIMIT

Quantity = Callable[[Trajectory], np.ndarray]

PERIOD = PROPOSED.period
DURATION = CYCLES * PERIOD
# The phases of the profile, and so its cycle, begin and end on whole milliseconds.
CYCLE = round(PERIOD / LAW_DT)
SPLIT = 1.2  # s; the time axis of a cycle changes its scale here
CHATTER = 0.3  # s; of the unregularised law's panels, short enough to resolve its chattering
NO_CURVES = "The paper's curves are not available as data"
DOTTED = f"{NO_CURVES}: dotted are the numbers of its text."
# Figures 6 to 9: nominal, lightest with least friction, heaviest with most.
PLANTS = ((NOMINAL.M, NOMINAL.mu), *zip(published.M_RANGE, published.MU_RANGE, strict=True))
PLANT_COLOURS = (INK, GREEN, PURPLE)
PLANT_DASHES = ("-", (0.0, (5.0, 1.6)), (0.0, (2.5, 1.2)))
TWO_STAGES = (1.5, 1.0)  # ratio of the widths of two columns


@cache
def profile_runs() -> list[Trajectory]:
    """The proposed profile and EPC under (35), nominal plant, five cycles, no torque limit."""
    return simulate(feedback_linearising()) + simulate(epc())


@cache
def adaptive_runs() -> dict[str, list[Trajectory]]:
    """Both forms of the adaptive law on `PLANTS`, five cycles, the environment's torque limit."""
    laws = {REGULARISED_LAW: adaptive(), CORRECTED_LAW: adaptive_as_published()}
    return {name: simulate(law, PLANTS, torque_limit=TORQUE_LIMIT) for name, law in laws.items()}


def draw_tracking() -> Any:
    """Fig. 3: rate and angle of the pendulum under feedback linearisation along both profiles."""
    figure = new_figure(4.6)
    # The time axis changes its scale at SPLIT: a quick stage, then a slow one.
    panels = figure.subplots(2, 2, sharey="row", sharex="col", width_ratios=TWO_STAGES)
    rates, angles = panels
    cycle = slice(0, CYCLE + 1)
    for run, (name, numbers) in zip(profile_runs(), published.RUNS.items(), strict=True):
        pen = PENS[name]
        swing = np.degrees(run.theta)
        target = np.degrees(run.reference[:, 0])
        label = f"{name}, found: {run.theta_dot.max():.2f} rad/s, {swing.max():.2f}°"
        for row, wanted, found, key, unit in (
            (rates, run.reference[:, 1], run.theta_dot, "peak_velocity", " rad/s"),
            (angles, target, swing, "swing", "°"),
        ):
            value = numbers[key].value
            stated = f"published, {name}: {value:g}{unit}"
            for axes, text in zip(row, ("", stated), strict=True):
                axes.plot(run.t[cycle], wanted[cycle], **REFERENCE)
                axes.plot(run.t[cycle], found[cycle], **pen, label=label)
                mark_published(axes, value, text, pen["color"])
    first, second = angles
    first.set(ylabel="angle θ (deg)", ylim=(-70.0, 100.0))
    first.set(xlabel="time in the cycle (s)", xlim=(0.0, SPLIT))
    second.set(xlabel="time in the cycle (s), compressed", xlim=(SPLIT, PERIOD))
    axes = rates[0]
    axes.plot([], [], **REFERENCE, label="reference")
    axes.legend(loc="center right")
    axes.set_title("Figure 3: tracking of the two profiles")
    axes.set(ylabel="rate θ' (rad/s)", ylim=(-1.0, 12.5))
    add_note(figure, f"Largest rates and angles are what the profiles were calibrated to. {DOTTED}")
    return figure


def draw_displacement() -> Any:
    """Fig. 4: displacement over five cycles."""
    figure = new_figure(3.3)
    axes = figure.subplots()
    for run, (name, numbers) in zip(profile_runs(), published.RUNS.items(), strict=True):
        pen = PENS[name]
        label = f"{name}, found: {run.metrics['mean_speed']:.3f} cm/s"
        axes.plot(run.t, 100.0 * run.x, **pen, label=label)
        value = numbers["mean_speed"].value
        dotted = {"color": pen["color"], "linestyle": PUBLISHED_DASHES}
        label = f"{name}, published: {value:g} cm/s"
        axes.plot([0.0, DURATION], [0.0, value * DURATION], **dotted, label=label)
    axes.set(title="Figure 4: displacement for five cycles", xlim=(0.0, DURATION))
    axes.set(xlabel="time (s)", ylabel="displacement x (cm)")
    axes.legend(loc="upper left")
    add_note(figure, f"The speeds are larger than published, in the other order. {DOTTED}")
    return figure


def draw_torque() -> Any:
    """Fig. 5: motor torque over five cycles under feedback linearisation."""
    figure = new_figure(4.4)
    panels = figure.subplots(2, 2, width_ratios=TWO_STAGES, sharex="col", sharey="row")
    for row, run, name in zip(panels, profile_runs(), published.RUNS, strict=True):
        value = published.RUNS[name]["peak_torque"].value
        for axes, label in zip(row, ("", f"published largest: {value:g} N m"), strict=True):
            axes.plot(run.t[1:], run.torque[1:], color=PENS[name]["color"], lw=1.0)
            mark_published(axes, -value, "")
            mark_published(axes, value, label)
        largest = run.metrics["peak_torque"]
        row[0].set(title=f"{name}: largest {largest:.3f} N m", ylabel="torque u (N m)")
    title = "Figure 5: input torque, five cycles and the first second"
    figure.suptitle(title, x=0.01, ha="left", fontsize=8.5)
    panels[1][0].set(xlabel="time (s)", xlim=(0.0, DURATION))
    panels[1][1].set(xlabel="time (s)", xlim=(0.0, 1.0))
    add_note(figure, f"The published torques cannot reach the published rates. {DOTTED}")
    return figure


def _draw_law(title: str, quantities: dict[str, Quantity], stated: str) -> Any:
    """Quantities, by their label, on the three plants.

    The left column shows the whole runs of the regularised law, the right one the start of those of
    the other. A cross marks loss of contact; the note compares the largest values of the whole runs
    with what is published.
    """
    figure = new_figure(1.4 + 1.7 * len(quantities))
    panels = figure.subplots(len(quantities), 2, sharex="col", squeeze=False)
    regularised, corrected = adaptive_runs().values()
    for (left, right), (label, quantity) in zip(panels, quantities.items(), strict=True):
        _draw_plants(left, regularised, quantity, DURATION)
        _draw_plants(right, corrected, quantity, CHATTER)
        left.set_ylabel(label)
    left, right = panels[0]
    left.set_title(f"{title}, {REGULARISED_LAW}")
    right.set_title(f"{CORRECTED_LAW}, the first {CHATTER:g} s")
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    legend = left.get_legend_handles_labels()
    figure.legend(*legend, loc="outside upper center", ncols=len(PLANTS))
    largest = "; ".join(
        f"{law} {_largest(runs, quantities)}" for law, runs in adaptive_runs().items()
    )
    ends = [f"{run.t[-1]:.2f} s" for run in corrected if not run.completed]
    law = f"{CORRECTED_LAW.capitalize()}, with the torque limit of {TORQUE_LIMIT:g} N m"
    lost = f"{len(ends)} of {len(PLANTS)} runs loses contact with the floor"
    add_note(
        figure,
        f"Largest absolute values, in the units of the panels: {largest}. In print: {stated}. "
        f"{NO_CURVES}. {law}: {lost}, at {' and '.join(ends)} (cross).",
    )
    return figure


def _draw_plants(axes: Any, runs: list[Trajectory], quantity: Quantity, end: float) -> None:
    """A quantity of the runs on `PLANTS` in the first `end` seconds."""
    window = slice(1, round(end / LAW_DT) + 1)
    for (M, mu), colour, dashes, run in zip(PLANTS, PLANT_COLOURS, PLANT_DASHES, runs, strict=True):
        values = quantity(run)
        pen = {"color": colour, "linestyle": dashes, "lw": 1.0}
        axes.plot(run.t[window], values[window], **pen, label=f"M = {M:g} kg, μ = {mu:g}")
        if not run.completed:
            axes.plot(run.t[-1], values[-1], "x", color=colour, ms=6, mew=1.6)
    axes.set_xlim(0.0, end)


def _largest(runs: list[Trajectory], quantities: dict[str, Quantity]) -> str:
    found = []
    for quantity in quantities.values():
        largest = max(np.abs(quantity(run)).max() for run in runs)
        found.append(f"{largest:.3g}")
    return " and ".join(found)


def draw_adaptive_tracking() -> Any:
    """Fig. 6: rate and angle under the adaptive law (39)."""
    rate = published.ADAPTIVE_PEAK_VELOCITY.value
    quantities: dict[str, Quantity] = {
        "rate θ' (rad/s)": lambda run: run.theta_dot,
        "angle θ (deg)": lambda run: np.degrees(run.theta),
    }
    stated = f"{rate:g} rad/s. Grey: the reference"
    figure = _draw_law("Figure 6: adaptive law (39)", quantities, stated)
    run = adaptive_runs()[REGULARISED_LAW][0]
    for axes in figure.axes[:2]:
        axes.plot(run.t, run.reference[:, 1], **REFERENCE)
        axes.set_ylim(-1.2, 9.5)
        mark_published(axes, rate, f"published largest: {rate:g} rad/s")
    for axes in figure.axes[2:]:
        axes.plot(run.t, np.degrees(run.reference[:, 0]), **REFERENCE)
    return figure


def draw_adaptive_torque() -> Any:
    """Fig. 8: motor torque under the adaptive law."""
    torque = published.PROPOSED["peak_torque"].value
    stated = f"no number here; {torque:g} N m for the law (35) on the same profile"
    quantities: dict[str, Quantity] = {"torque u (N m)": lambda run: run.torque}
    figure = _draw_law("Figure 8: torque of the law (39)", quantities, stated)
    mark_published(figure.axes[0], torque, f"{torque:g} N m", MUTED, x=0.58)
    return figure


def draw_adaptive_error() -> Any:
    """Fig. 7: tracking errors under the adaptive law."""
    quantities: dict[str, Quantity] = {
        r"angle error $\theta - \theta_d$ (mrad)": lambda run: 1e3 * run.error,
        r"rate error $\dot\theta - \dot\theta_d$ (mrad/s)": lambda run: 1e3 * run.rate_error,
    }
    stated = (
        "'tracks the planned trajectory accurately', 'the angular velocity will eventually "
        "converge to zero'"
    )
    return _draw_law("Figure 7: tracking errors", quantities, stated)


def draw_sliding_variable() -> Any:
    """Fig. 9: delta_theta under the adaptive law."""
    quantities: dict[str, Quantity] = {
        r"$\delta_\theta$ (mrad/s)": lambda run: 1e3 * sliding(run)[0]
    }
    title = r"Figure 9: sliding variable $\delta_\theta$ of (37b)"
    stated = "'convergence towards zero'; the progressive stage of every cycle excites it anew"
    return _draw_law(title, quantities, stated)


FIGURES: dict[str, Callable[[], Any]] = {
    "fig3_tracking": draw_tracking,
    "fig4_displacement": draw_displacement,
    "fig5_torque": draw_torque,
    "fig6_adaptive_tracking": draw_adaptive_tracking,
    "fig7_adaptive_error": draw_adaptive_error,
    "fig8_adaptive_torque": draw_adaptive_torque,
    "fig9_sliding_variable": draw_sliding_variable,
}


def draw_all(directory: Path) -> list[Path]:
    """Draws every figure as SVG and PNG into a folder, which is created.

    Repeated runs give identical files.
    """
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    with style():
        for name, draw in FIGURES.items():
            written += save(draw(), directory / name)
    return written
