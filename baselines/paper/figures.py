"""Figures 3 to 9 of the paper from our own runs, with the published numbers."""

from collections.abc import Callable
from functools import cache, partial
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
CHATTER = (
    0.3  # s; duration of the unregularised law's panels, short enough to resolve its chattering
)
NO_CURVES = "The paper's curves are not available as data"
DOTTED = f"{NO_CURVES}: dotted are the numbers of its text."
# Figures 6 to 9: nominal, lightest with least friction, heaviest with most.
PLANTS = ((NOMINAL.M, NOMINAL.mu), *zip(published.M_RANGE, published.MU_RANGE, strict=True))
PLANT_COLOURS, PLANT_DASHES = (INK, GREEN, PURPLE), ("-", (0.0, (5.0, 1.6)), (0.0, (2.5, 1.2)))


@cache
def profile_runs() -> list[Trajectory]:
    """The proposed profile and EPC under (35) on the nominal plant, five cycles without a torque
    limit.
    """
    return [simulate(feedback_linearising())[0], simulate(epc())[0]]


@cache
def adaptive_runs() -> dict[str, list[Trajectory]]:
    """Both forms of the adaptive law on `PLANTS`, five cycles with the environment's torque
    limit.
    """
    laws = {REGULARISED_LAW: adaptive(), CORRECTED_LAW: adaptive_as_published()}
    return {name: simulate(law, PLANTS, torque_limit=TORQUE_LIMIT) for name, law in laws.items()}


def draw_tracking() -> Any:
    """Fig. 3: rate and angle of the pendulum under feedback linearisation along both profiles."""
    figure = new_figure(4.6)
    # The time axis changes its scale at SPLIT: a quick stage, then a slow one.
    panels = figure.subplots(2, 2, sharey="row", sharex="col", width_ratios=(1.5, 1.0))
    cycle = slice(0, CYCLE + 1)
    for run, (name, numbers) in zip(profile_runs(), published.RUNS.items(), strict=True):
        pen, degrees = PENS[name], np.degrees(run.theta)
        label = f"{name}, found: {run.theta_dot.max():.2f} rad/s, {degrees.max():.2f}°"
        for row, target, found, key, unit in (
            (panels[0], run.reference[:, 1], run.theta_dot, "peak_velocity", " rad/s"),
            (panels[1], np.degrees(run.reference[:, 0]), degrees, "swing", "°"),
        ):
            value = numbers[key].value
            for axes, stated in zip(row, ("", f"published, {name}: {value:g}{unit}"), strict=True):
                axes.plot(run.t[cycle], target[cycle], **REFERENCE)
                axes.plot(run.t[cycle], found[cycle], **pen, label=label)
                mark_published(axes, value, stated, pen["color"])
    panels[0][0].plot([], [], **REFERENCE, label="reference")
    panels[0][0].legend(loc="center right")
    panels[0][0].set(
        title="Figure 3: tracking of the two profiles", ylabel="rate θ' (rad/s)", ylim=(-1.0, 12.5)
    )
    panels[1][0].set(ylabel="angle θ (deg)", ylim=(-70.0, 100.0))
    panels[1][0].set(xlabel="time in the cycle (s)", xlim=(0.0, SPLIT))
    panels[1][1].set(xlabel="time in the cycle (s), compressed", xlim=(SPLIT, PERIOD))
    add_note(figure, f"Largest rates and angles are what the profiles were calibrated to. {DOTTED}")
    return figure


def draw_displacement() -> Any:
    """Fig. 4: displacement over five cycles."""
    figure = new_figure(3.3)
    axes = figure.subplots()
    for run, (name, numbers) in zip(profile_runs(), published.RUNS.items(), strict=True):
        pen, value = PENS[name], numbers["mean_speed"].value
        axes.plot(
            run.t,
            100.0 * run.x,
            **pen,
            label=f"{name}, found: {run.metrics['mean_speed']:.3f} cm/s",
        )
        dotted = {"linestyle": PUBLISHED_DASHES, "label": f"{name}, published: {value:g} cm/s"}
        axes.plot([0.0, DURATION], [0.0, value * DURATION], color=pen["color"], **dotted)
    axes.set(title="Figure 4: displacement for five cycles", xlim=(0.0, DURATION))
    axes.set(xlabel="time (s)", ylabel="displacement x (cm)")
    axes.legend(loc="upper left")
    add_note(figure, f"The speeds are larger than published, in the other order. {DOTTED}")
    return figure


def draw_torque() -> Any:
    """Fig. 5: motor torque over five cycles under feedback linearisation."""
    figure = new_figure(4.4)
    panels = figure.subplots(2, 2, width_ratios=(1.5, 1.0), sharex="col", sharey="row")
    for row, run, (name, numbers) in zip(
        panels, profile_runs(), published.RUNS.items(), strict=True
    ):
        value = numbers["peak_torque"].value
        for axes, label in zip(row, ("", f"published largest: {value:g} N m"), strict=True):
            axes.plot(run.t[1:], run.torque[1:], color=PENS[name]["color"], lw=1.0)
            mark_published(axes, -value, "")
            mark_published(axes, value, label)
        row[0].set(
            title=f"{name}: largest {run.metrics['peak_torque']:.3f} N m", ylabel="torque u (N m)"
        )
    figure.suptitle(
        "Figure 5: input torque, five cycles and the first second", x=0.01, ha="left", fontsize=8.5
    )
    panels[1][0].set(xlabel="time (s)", xlim=(0.0, DURATION))
    panels[1][1].set(xlabel="time (s)", xlim=(0.0, 1.0))
    add_note(figure, f"The published torques cannot reach the published rates. {DOTTED}")
    return figure


def _draw_law(title: str, quantities: dict[str, Quantity], stated: str) -> Any:
    """Quantities, by their label, on the three plants: the whole run of the regularised law, the
    start of the other.

    A cross marks loss of contact; the note compares the largest values of the whole runs with what
    is published.
    """
    figure = new_figure(1.4 + 1.7 * len(quantities))
    panels = figure.subplots(len(quantities), 2, sharex="col", squeeze=False)
    largest: dict[str, list[str]] = {}
    for column, end, (law, runs) in zip(
        panels.T, (DURATION, CHATTER), adaptive_runs().items(), strict=True
    ):
        window = slice(1, round(end / LAW_DT) + 1)
        for axes, (label, quantity) in zip(column, quantities.items(), strict=True):
            for (M, mu), colour, dashes, run in zip(
                PLANTS, PLANT_COLOURS, PLANT_DASHES, runs, strict=True
            ):
                drawn = {
                    "color": colour,
                    "linestyle": dashes,
                    "label": f"M = {M:g} kg, μ = {mu:g}",
                    "lw": 1.0,
                }
                axes.plot(run.t[window], quantity(run)[window], **drawn)
                if not run.completed:
                    axes.plot(run.t[-1], quantity(run)[-1], "x", color=colour, ms=6, mew=1.6)
            axes.set(xlim=(0.0, end), ylabel=label if end == DURATION else "")
            largest.setdefault(law, []).append(
                f"{max(np.abs(quantity(run)).max() for run in runs):.3g}"
            )
        column[0].set_title(f"{title}, {law}" if end == DURATION else f"{law}, the first {end:g} s")
        column[-1].set_xlabel("time (s)")
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    ended = [f"{run.t[-1]:.2f} s" for run in adaptive_runs()[CORRECTED_LAW] if not run.completed]
    found = "; ".join(f"{law} {' and '.join(values)}" for law, values in largest.items())
    add_note(
        figure,
        f"Largest absolute values, in the units of the panels: {found}. In print: {stated}. {NO_CURVES}. "
        f"{CORRECTED_LAW.capitalize()}, with the torque limit of {TORQUE_LIMIT:g} N m: {len(ended)} of {len(PLANTS)} "
        f"runs loses contact with the floor, at {' and '.join(ended)} (cross).",
    )
    return figure


def draw_adaptive_tracking() -> Any:
    """Fig. 6: rate and angle under the adaptive law (39)."""
    rate = published.ADAPTIVE_PEAK_VELOCITY.value
    quantities: dict[str, Quantity] = {
        "rate θ' (rad/s)": lambda run: run.theta_dot,
        "angle θ (deg)": lambda run: np.degrees(run.theta),
    }
    figure = _draw_law(
        "Figure 6: adaptive law (39)", quantities, f"{rate:g} rad/s. Grey: the reference"
    )
    run = adaptive_runs()[REGULARISED_LAW][0]
    for n, axes in enumerate(figure.axes):
        axes.plot(
            run.t, run.reference[:, 1] if n < 2 else np.degrees(run.reference[:, 0]), **REFERENCE
        )
        if n < 2:
            axes.set_ylim(-1.2, 9.5)
            mark_published(axes, rate, f"published largest: {rate:g} rad/s")
    return figure


def draw_adaptive_torque() -> Any:
    """Fig. 8: motor torque under the adaptive law."""
    torque = published.PROPOSED["peak_torque"].value
    stated = f"no number here; {torque:g} N m for the law (35) on the same profile"
    figure = _draw_law(
        "Figure 8: torque of the law (39)", {"torque u (N m)": lambda run: run.torque}, stated
    )
    mark_published(figure.axes[0], torque, f"{torque:g} N m", MUTED, x=0.58)
    return figure


FIGURES: dict[str, Callable[[], Any]] = {
    "fig3_tracking": draw_tracking,
    "fig4_displacement": draw_displacement,
    "fig5_torque": draw_torque,
    "fig6_adaptive_tracking": draw_adaptive_tracking,
    "fig7_adaptive_error": partial(
        _draw_law,
        "Figure 7: tracking errors",
        {
            r"angle error $\theta - \theta_d$ (mrad)": lambda run: 1e3 * run.error,
            r"rate error $\dot\theta - \dot\theta_d$ (mrad/s)": lambda run: 1e3 * run.rate_error,
        },
        "'tracks the planned trajectory accurately', 'the angular velocity will eventually converge to zero'",
    ),
    "fig8_adaptive_torque": draw_adaptive_torque,
    "fig9_sliding_variable": partial(
        _draw_law,
        r"Figure 9: sliding variable $\delta_\theta$ of (37b)",
        {r"$\delta_\theta$ (mrad/s)": lambda run: 1e3 * sliding(run)[0]},
        "'convergence towards zero'; the progressive stage of every cycle excites it anew",
    ),
}


def draw_all(directory: Path) -> list[Path]:
    """Draws every figure as SVG and PNG into a folder, which is created; repeated runs give
    identical files.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with style():
        return [path for name, draw in FIGURES.items() for path in save(draw(), directory / name)]
