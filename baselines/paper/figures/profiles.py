"""Figures 3 to 5 of the paper from our own runs, and a comparison of its two profiles, beside what is published."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.drawing import (
    INK,
    PENS,
    PUBLISHED_DASHES,
    REFERENCE,
    Pen,
    add_note,
    listed,
    mark_published,
    new_figure,
    split_axes,
)
from baselines.laws.feedback_linearisation import epc, feedback_linearising
from baselines.laws.profiles import EPC, PROPOSED
from baselines.paper import published
from baselines.paper.traces import CYCLES, Trace, trace
from capsule_gym.parameters import LAW_DT

SPLIT = 1.2
NO_CURVES = "The paper's curves are not available as data: dotted are the numbers of its text."
STATED = {"proposed": published.PROPOSED, "EPC": published.EPC}
PERIOD = PROPOSED.period
# The phases of the profile begin and end on whole milliseconds, and so does its cycle.
CYCLE_SAMPLES = round(PERIOD / LAW_DT)


@dataclass(frozen=True)
class Runs:
    """The runs that the figures show, five cycles each from rest.

    Attributes:
        proposed: the paper's profile, feedback linearisation.
        epc: the EPC profile, likewise.
    """

    proposed: Trace
    epc: Trace


def run_profiles() -> Runs:
    """Runs both profiles on the nominal plant, without a torque limit."""
    return Runs(trace(feedback_linearising()), trace(epc()))


def draw_tracking(runs: Runs) -> Any:
    """Fig. 3: rate and angle of the pendulum under feedback linearisation along both profiles."""
    figure = new_figure(4.6)
    rate, angle = split_axes(figure, 2, SPLIT, PERIOD)
    for run, profile in ((runs.proposed, PROPOSED), (runs.epc, EPC)):
        pen = PENS[profile.name]
        one = slice(0, CYCLE_SAMPLES + 1)
        for axes in rate:
            axes.plot(run.t[one], run.theta_d_dot[one], **REFERENCE)
            axes.plot(run.t[one], run.theta_dot[one], **pen.line(label=f"{profile.name}, found"))
        for axes in angle:
            axes.plot(run.t[one], np.degrees(run.theta_d[one]), **REFERENCE)
            axes.plot(run.t[one], np.degrees(run.theta[one]), **pen.line())
    rate[0].plot([], [], **REFERENCE, label="reference")
    for name, numbers in STATED.items():
        for axes, key, unit in ((rate, "peak_velocity", " rad/s"), (angle, "swing", "°")):
            value = numbers[key].value
            mark_published(axes[0], value, "", PENS[name])
            mark_published(axes[1], value, f"published, {name}: {value:g}{unit}", PENS[name])
    rate[0].set(title="Figure 3: tracking of the two profiles", ylabel="rate θ' (rad/s)", ylim=(-1.0, 12.5))
    angle[0].set(ylabel="angle θ (deg)", ylim=(-70.0, 100.0))
    rate[0].legend(loc="center right")
    peaks = [run.theta_dot.max() for run in (runs.proposed, runs.epc)]
    swings = [np.degrees(run.theta.max()) for run in (runs.proposed, runs.epc)]
    rates, angles = _stated("peak_velocity"), _stated("swing")
    add_note(
        figure,
        f"Largest rate: found {listed(peaks, 2, 'rad/s')}, published {rates[0]:g} and {rates[1]:g}. Largest angle: "
        f"found {listed(swings, 2, 'deg')}, published {angles[0]:g} and {angles[1]:g}. Both are what the profiles were "
        f"calibrated to. {NO_CURVES}",
    )
    return figure


def draw_displacement(runs: Runs) -> Any:
    """Fig. 4: displacement over five cycles."""
    figure = new_figure(3.3)
    course, cycle = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    speeds, slides = [], []
    stated = _stated("mean_speed")
    for run, profile, value in ((runs.proposed, PROPOSED, stated[0]), (runs.epc, EPC, stated[1])):
        pen = PENS[profile.name]
        speeds.append(run.metrics["mean_speed"])
        course.plot(run.t, 100.0 * run.x, **pen.line(label=f"{profile.name}, found: {speeds[-1]:.2f} cm/s"))
        end = run.t[-1]
        label = f"{profile.name}, published: {value} cm/s"
        course.plot([0.0, end], [0.0, value * end], color=pen.colour, linestyle=PUBLISHED_DASHES, label=label)
        last = 100.0 * (run.x[-CYCLE_SAMPLES - 1 :] - run.x[-CYCLE_SAMPLES - 1])
        cycle.plot(np.arange(CYCLE_SAMPLES + 1) * LAW_DT, last, **pen.line())
        slides.append(10.0 * (last.max() - last[-1]))
    course.set(
        title="Figure 4: displacement for five cycles",
        xlabel="time (s)",
        ylabel="displacement x (cm)",
        xlim=(0.0, 33.0),
    )
    course.set_ylim(bottom=-1.0)
    course.legend(loc="upper left")
    cycle.set(title="Fifth cycle", xlabel="time in the cycle (s)", ylabel="displacement in it (cm)", xlim=(0.0, PERIOD))
    add_note(
        figure,
        f"Mean speed: found {listed(speeds, 3, 'cm/s')}, published {listed(stated, 3, 'cm/s')}: larger by factors of "
        f"{_factors(speeds, stated)} and in the other order. In the fifth cycle the platform slides back by "
        f"{listed(slides, 1, 'mm')}. {NO_CURVES}",
    )
    return figure


def draw_torque(runs: Runs) -> Any:
    """Fig. 5: motor torque over five cycles under feedback linearisation."""
    figure = new_figure(4.4)
    grid = figure.subplots(2, 2, width_ratios=(1.5, 1.0), sharex="col", sharey="row")
    peaks = []
    stated = _stated("peak_torque")
    for row, run, profile, value in zip(grid, (runs.proposed, runs.epc), (PROPOSED, EPC), stated, strict=True):
        pen = PENS[profile.name]
        peaks.append(run.metrics["peak_torque"])
        for axes in row:
            axes.plot(run.t[1:], run.torque[1:], **pen.line(linestyle="-", lw=1.0))
            mark_published(axes, -value, "", Pen(INK))
        mark_published(row[0], value, "", Pen(INK))
        mark_published(row[1], value, f"published largest: {value:g} N m", Pen(INK))
        row[0].set(ylabel="torque u (N m)")
        row[0].set_title(f"{profile.name}: largest {peaks[-1]:.3f} N m")
    grid[0][0].set_title(f"Figure 5: input torque, {PROPOSED.name}: largest {peaks[0]:.3f} N m")
    grid[0][1].set_title("The first second")
    grid[1][0].set(xlabel="time (s)", xlim=(0.0, 33.0))
    grid[1][1].set(xlabel="time (s)", xlim=(0.0, 1.0))
    add_note(
        figure,
        f"Largest torque: found {listed(peaks, 3, 'N m')}, published {listed(stated, 4, 'N m')}: larger by factors of "
        f"{_factors(peaks, stated)} in the same order. The published torques cannot reach the published rates. "
        f"{NO_CURVES}",
    )
    return figure


def _stated(key: str) -> tuple[float, float]:
    """A published number of the proposed profile and of EPC."""
    return published.PROPOSED[key].value, published.EPC[key].value


def _factors(found: Sequence[float], stated: Sequence[float]) -> str:
    """Found over published, in words."""
    return " and ".join(f"{a / b:.1f}" for a, b in zip(found, stated, strict=True))


def draw_profiles(runs: Runs) -> Any:
    """Both profiles over one cycle: angle, rate, displacement and torque."""
    figure = new_figure(6.2)
    rows = split_axes(figure, 4, SPLIT, PERIOD)
    labels = ("angle θ (deg)", "rate θ' (rad/s)", "displacement x (cm)", "torque u (N m)")
    for run, profile in ((runs.proposed, PROPOSED), (runs.epc, EPC)):
        last = slice(-CYCLE_SAMPLES - 1, None)
        t = np.arange(CYCLE_SAMPLES + 1) * LAW_DT
        x = 100.0 * (run.x[last] - run.x[last][0])
        # The torque on record at an instant ended there: the first sample belongs to the cycle before.
        torque = np.append(run.torque[last][1:], np.nan)
        for axes, values in zip(rows, (np.degrees(run.theta[last]), run.theta_dot[last], x, torque), strict=True):
            for part in axes:
                part.plot(t, values, **PENS[profile.name].line(label=profile.name))
    for axes, label in zip(rows, labels, strict=True):
        axes[0].set_ylabel(label)
    rows[0][0].set_title("The two profiles over the fifth cycle, tracked by the law (35)")
    rows[0][1].legend(loc="upper right")
    add_note(
        figure,
        "Found per cycle: "
        + "; ".join(
            f"{profile.name} {run.metrics['distance'] * 100.0 / CYCLES:.2f} cm with "
            f"{run.metrics['energy'] / CYCLES:.2f} J, cost of transport {run.metrics['cost_of_transport']:.2f}"
            for run, profile in ((runs.proposed, PROPOSED), (runs.epc, EPC))
        )
        + f". Published: {listed([PERIOD * speed for speed in _stated('mean_speed')], 2, 'cm')}, no energy.",
    )
    return figure


PROFILE_FIGURES: dict[str, Callable[[Runs], Any]] = {
    "fig3_tracking": draw_tracking,
    "fig4_displacement": draw_displacement,
    "fig5_torque": draw_torque,
    "profiles": draw_profiles,
}
