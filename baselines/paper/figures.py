"""Figures 1 to 9 of the paper from our own runs, with the published numbers, and two of our own.

`FIGURES` names them all; each is a function of `Runs`. `draw_all` also draws the figures of the gaits and the optimum.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from baselines.drawing import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    PENS,
    PUBLISHED_DASHES,
    PURPLE,
    REFERENCE,
    VERMILION,
    Pen,
    add_note,
    listed,
    mark_published,
    new_figure,
    save,
    style,
)
from baselines.laws.adaptive import adaptive, adaptive_as_published
from baselines.laws.feedback_linearisation import epc, feedback_linearising
from baselines.laws.gains import PUBLISHED
from baselines.laws.profiles import PROPOSED
from baselines.paper import published
from baselines.paper.adaptive import CORRECTED_LAW, REGULARISED_LAW
from baselines.paper.principles import RESTORING_PHASES
from baselines.paper.proofs import swing_envelope
from baselines.paper.selection import ROMAN
from baselines.paper.tracking import CYCLES, PROFILES, Trajectory, grid, simulate, speed_map, speed_ratio
from baselines.tables import printed_above
from capsule_gym.parameters import LAW_DT, NOMINAL
from capsule_gym.task import TORQUE_LIMIT

Quantity = Callable[[Trajectory], np.ndarray]

PERIOD = PROPOSED.period
DURATION = CYCLES * PERIOD
# The phases of the profile, and so its cycle, begin and end on whole milliseconds.
CYCLE = round(PERIOD / LAW_DT)
# The time axis of a cycle changes its scale here, s.
SPLIT = 1.2
FIRST_SWING = 0.9  # s
# Of the unregularised law's panel, s: long enough to show what it does, short enough to resolve its chattering.
CHATTER = 0.3
NO_CURVES = "The paper's curves are not available as data"
DOTTED = f"{NO_CURVES}: dotted are the numbers of its text."
# Figures 6 to 9: nominal, lightest with least friction, heaviest with most.
PLANTS = ((NOMINAL.M, NOMINAL.mu), *zip(published.M_RANGE, published.MU_RANGE, strict=True))
PLANT_PENS = (Pen(INK), Pen(GREEN, (0.0, (5.0, 1.6))), Pen(PURPLE, (0.0, (2.5, 1.2))))
TOP_RATE = 13.5  # of the phase planes, rad/s
ARROW: dict[str, Any] = {"arrowstyle": "-|>", "shrinkA": 0.0, "shrinkB": 0.0, "mutation_scale": 9.0, "lw": 1.2}


class Runs:
    """The runs that the figures show, five cycles each from rest, computed when they are first used."""

    @cached_property
    def profiles(self) -> list[Trajectory]:
        """The proposed profile and EPC under (35) on the nominal plant, without a torque limit."""
        return [simulate(feedback_linearising())[0], simulate(epc())[0]]

    @cached_property
    def adaptive(self) -> dict[str, list[Trajectory]]:
        """Both forms of the adaptive law on `PLANTS`, with the environment's torque limit."""
        laws = {REGULARISED_LAW: adaptive(), CORRECTED_LAW: adaptive_as_published()}
        return {name: simulate(law, PLANTS, torque_limit=TORQUE_LIMIT) for name, law in laws.items()}


def _stated(key: str) -> list[float]:
    """A published number of the proposed profile and of EPC."""
    return [numbers[key].value for numbers in published.RUNS.values()]


def _factors(found: Sequence[float], stated: Sequence[float]) -> str:
    """Found over published, in words."""
    return " and ".join(f"{a / b:.1f}" for a, b in zip(found, stated, strict=True))


def draw_capsule(runs: Runs) -> Any:
    """Fig. 1: the capsule robot, its constants, coordinates and forces."""
    from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Rectangle

    figure = new_figure(3.7)
    axes = figure.subplots()
    axes.set(aspect="equal", xlim=(-2.6, 2.6), ylim=(-0.78, 1.85), title="Figure 1: the vibro-driven capsule")
    axes.axis("off")
    # In lengths of the pendulum; the pivot lies at x = 0.
    angle, y, floor, radius = math.radians(32.0), 0.42, -0.2, 0.12
    ball = (-math.sin(angle), y + math.cos(angle))
    leader = {"arrowstyle": "-", "color": MUTED, "lw": 0.7, "shrinkA": 2.0, "shrinkB": 0.0}

    def arrow(tail: tuple[float, float], tip: tuple[float, float], colour: str, **more: Any) -> None:
        axes.annotate("", tip, tail, arrowprops={**ARROW, "color": colour, **more})

    shape: dict[str, Any] = {"boxstyle": "round,pad=0,rounding_size=0.62", "facecolor": "#f6f8fb", "edgecolor": MUTED}
    axes.add_patch(FancyBboxPatch((-0.95, floor + 0.02), 1.9, 1.86, lw=1.0, ls=(0.0, (5.0, 2.0)), **shape))
    axes.add_patch(Rectangle((-0.77, floor + 0.02), 1.54, 0.3, facecolor="#dbe3ee", edgecolor=INK, lw=1.2))
    axes.plot([-2.5, 2.5], [floor, floor], color=INK, lw=1.4)
    for x in np.arange(-2.45, 2.5, 0.14):
        axes.plot([x, x - 0.09], [floor, floor - 0.09], color=MUTED, lw=0.7)
    axes.text(0.0, floor + 0.17, "platform, M", ha="center", va="center")
    axes.annotate("massless shell", (0.78, 1.48), (1.5, 1.62), va="center", color=MUTED, arrowprops=leader)

    axes.plot([0.0, 0.0], [floor + 0.32, y], color=INK, lw=3.0, solid_capstyle="butt")
    axes.plot([0.0, 0.0], [y, y + 1.3], color=MUTED, lw=0.8, linestyle=(0.0, (5.0, 2.5)))
    axes.plot([0.0, ball[0]], [y, ball[1]], color=BLUE, lw=2.6, solid_capstyle="round")
    axes.add_patch(Circle(ball, radius, facecolor=BLUE, edgecolor=INK, lw=1.0, zorder=3))
    axes.add_patch(Circle((0.0, y), 0.055, facecolor="white", edgecolor=INK, lw=1.2, zorder=4))
    edge = (ball[0] - radius * math.cos(0.15), ball[1] + radius * math.sin(0.15))
    axes.annotate("ball, m", edge, (-1.62, 1.42), va="center", ha="center", arrowprops=leader)
    axes.text(-0.5 * math.sin(angle) - 0.13, y + 0.5 * math.cos(angle) + 0.04, "l", style="italic", ha="center")
    # A spiral about the pivot represents the torsional spring.
    turn = np.linspace(0.0, 5.0 * math.pi, 200)
    axes.plot((0.08 + 0.0095 * turn) * np.cos(turn), y + (0.08 + 0.0095 * turn) * np.sin(turn), color=GREEN, lw=0.9)
    label = "spring k and damper c\nat the pivot"
    axes.annotate(label, (0.22, y - 0.03), (1.5, 0.5), va="center", color=GREEN, arrowprops={**leader, "color": GREEN})

    # Theta from the upright to the rod, whose half width is not crossed; x from the start.
    arc = np.linspace(0.0, angle - 0.09, 40)
    axes.plot(-0.82 * np.sin(arc), y + 0.82 * np.cos(arc), color=INK, lw=1.0)
    tail, tip = ((-0.82 * math.sin(a), y + 0.82 * math.cos(a)) for a in (angle - 0.11, angle - 0.03))
    arrow(tail, tip, INK, lw=0.8)
    axes.text(-0.26, y + 0.9, "θ", ha="center", va="bottom", fontsize=9.5)
    for x in (0.0, -2.0):
        axes.plot([x, x], [floor - 0.14, floor - 0.52], color=MUTED, lw=0.8)
    arrow((-2.0, floor - 0.42), (0.0, floor - 0.42), INK)
    axes.text(-1.0, floor - 0.38, "x", ha="center", va="bottom", style="italic")
    axes.text(-2.0, floor - 0.54, "x = 0", ha="center", va="top", color=MUTED, fontsize=7.5)

    bend: dict[str, Any] = {"connectionstyle": "arc3,rad=0.45", "color": VERMILION}
    axes.add_patch(FancyArrowPatch((0.4, y - 0.1), (0.16, y + 0.38), **bend, **ARROW))
    axes.text(0.46, y + 0.26, "u", color=VERMILION, style="italic", fontsize=9.5)
    arrow((ball[0], ball[1] - radius), (ball[0], ball[1] - 0.5), VERMILION)
    axes.text(ball[0] - 0.07, ball[1] - 0.42, "m g", color=VERMILION, ha="right", style="italic")
    arrow((0.5, floor - 0.48), (0.5, floor), VERMILION)
    axes.text(0.56, floor - 0.46, "N", color=VERMILION, style="italic", va="bottom")
    arrow((1.5, floor + 0.08), (0.8, floor + 0.08), VERMILION)
    axes.text(1.56, floor + 0.08, "f, sliding forwards", color=VERMILION, va="center")
    c = NOMINAL
    add_note(
        figure,
        f"Section 5: M = {c.M:g} kg, m = {c.m:g} kg, l = {c.l:g} m, k = {c.k:g} N m/rad, c = {c.c:g} N m s/rad, μ = "
        f"{c.mu:g}, g = {c.g:g} m/s². The ball sits at x \N{MINUS SIGN} l sin θ: a growing θ swings it backwards and "
        "pushes the platform forwards. The motor's torque u (printed as τ too), spring and damper act between pendulum "
        "and platform; only N and f act from outside.",
    )
    return figure


def draw_phases(runs: Runs) -> Any:
    """Fig. 2: the seven phases of the profile (9), with its times and amplitudes; each phase as wide as the next."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    pen, count = PENS[PROPOSED.name], len(PROPOSED.segments)
    V1, P2, P3 = 1.0, 0.36, 0.3
    levels = [(0.0, V1), (V1, V1), (V1, P2), (P2, 0.0), (0.0, -P3), (-P3, -P3), (-P3, 0.0)]
    axes.axvspan(count - RESTORING_PHASES, count, color="#eef1f5", linewidth=0.0, zorder=0.5)
    s = np.linspace(0.0, 1.0, 101)
    for n, (begin, end) in enumerate(levels):
        rate = begin + (end - begin) * s
        if n == 0:
            rate = V1 * np.sin(0.5 * math.pi * s)
        elif n == 2:
            rate = V1 * np.cos(math.acos(P2 / V1) * s)
        axes.plot(n + s, rate, **pen.line(lw=2.0))
        axes.text(n + 0.5, 1.2, ROMAN[n], ha="center", va="center", color=INK, fontsize=9.0)
    for n in range(1, count):
        axes.axvline(n, color="#c5ccd6", lw=0.7, zorder=0.9)
    axes.axhline(0.0, color=INK, lw=0.9, zorder=1.0)
    for level, reach in ((V1, 1.0), (P2, 3.0), (-P3, 5.0)):
        axes.plot([0.0, reach], [level, level], color=MUTED, lw=0.8, linestyle=PUBLISHED_DASHES, zorder=1.0)
    axes.set_yticks([V1, P2, 0.0, -P3], ["P₁ω", "P₂", "0", "\N{MINUS SIGN}P₃"], fontsize=9.0)
    axes.set_xticks(range(count + 1), [f"t{'₀₁₂₃₄₅₆₇'[n]}" for n in range(count + 1)], fontsize=9.0)
    axes.set(xlim=(0.0, count), ylim=(-0.52, 1.33), ylabel="rate of the reference θ'  (not to scale)")
    axes.set_xlabel("time, each phase drawn as wide as the next", labelpad=5.0)
    axes.set_title("Figure 2: the phases of the profile (9)")
    axes.grid(False)
    restoring = count - RESTORING_PHASES
    both = {**ARROW, "arrowstyle": "<|-|>", "color": INK, "lw": 0.8}
    for left, right, name in ((0, restoring, "progressive stage"), (restoring, count, "restoring stage")):
        axes.annotate("", (left + 0.04, -0.44), (right - 0.04, -0.44), arrowprops=both)
        axes.text(0.5 * (left + right), -0.42, name, ha="center", va="bottom")
    add_note(
        figure,
        f"t₁ to t₇ of Table 1: {', '.join(f'{t:g}' for t in PROPOSED.times)} s. The amplitudes are calibrated: P₁ω = "
        f"{PROPOSED.segments[1].offset:g}, P₂ = {PROPOSED.segments[3].offset:.3f}, P₃ = {PROPOSED.restoring_speed:.3f} "
        "rad/s, the last by closure. III and IV to VII as built: the printed formulas are neither continuous nor "
        "closed.",
    )
    return figure


def draw_tracking(runs: Runs) -> Any:
    """Fig. 3: rate and angle of the pendulum under feedback linearisation along both profiles."""
    figure = new_figure(4.6)
    # The time axis changes its scale at SPLIT: a quick stage, then a slow one.
    panels = rate, angle = figure.subplots(2, 2, sharey="row", sharex="col", width_ratios=(1.5, 1.0))
    for left, right in panels:
        left.set_xlim(0.0, SPLIT)
        right.set_xlim(SPLIT, PERIOD)
        right.spines["left"].set_visible(False)
        right.tick_params(axis="y", length=0.0)
    angle[0].set_xlabel("time in the cycle (s)")
    angle[1].set_xlabel("time in the cycle (s), compressed")
    for run, profile in zip(runs.profiles, PROFILES, strict=True):
        pen, one = PENS[profile.name], slice(0, CYCLE + 1)
        for axes in rate:
            axes.plot(run.t[one], run.reference[one, 1], **REFERENCE)
            axes.plot(run.t[one], run.theta_dot[one], **pen.line(label=f"{profile.name}, found"))
        for axes in angle:
            axes.plot(run.t[one], np.degrees(run.reference[one, 0]), **REFERENCE)
            axes.plot(run.t[one], np.degrees(run.theta[one]), **pen.line())
    rate[0].plot([], [], **REFERENCE, label="reference")
    for name, numbers in published.RUNS.items():
        for axes, key, unit in ((rate, "peak_velocity", " rad/s"), (angle, "swing", "°")):
            value = numbers[key].value
            mark_published(axes[0], value, "", PENS[name])
            mark_published(axes[1], value, f"published, {name}: {value:g}{unit}", PENS[name])
    rate[0].set(title="Figure 3: tracking of the two profiles", ylabel="rate θ' (rad/s)", ylim=(-1.0, 12.5))
    angle[0].set(ylabel="angle θ (deg)", ylim=(-70.0, 100.0))
    rate[0].legend(loc="center right")
    peaks, swings = zip(*((run.theta_dot.max(), np.degrees(run.theta.max())) for run in runs.profiles), strict=True)
    rates, angles = _stated("peak_velocity"), _stated("swing")
    add_note(
        figure,
        f"Largest rate: found {listed(peaks, 2, 'rad/s')}, published {rates[0]:g} and {rates[1]:g}. Largest angle: "
        f"found {listed(swings, 2, 'deg')}, published {angles[0]:g} and {angles[1]:g}. Both are what the profiles were "
        f"calibrated to. {DOTTED}",
    )
    return figure


def draw_displacement(runs: Runs) -> Any:
    """Fig. 4: displacement over five cycles."""
    figure = new_figure(3.3)
    whole, cycle = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    speeds, slides, stated = [], [], _stated("mean_speed")
    for run, profile, value in zip(runs.profiles, PROFILES, stated, strict=True):
        pen, end = PENS[profile.name], run.t[-1]
        speeds.append(run.metrics["mean_speed"])
        whole.plot(run.t, 100.0 * run.x, **pen.line(label=f"{profile.name}, found: {speeds[-1]:.2f} cm/s"))
        dotted = {"linestyle": PUBLISHED_DASHES, "label": f"{profile.name}, published: {value} cm/s"}
        whole.plot([0.0, end], [0.0, value * end], color=pen.colour, **dotted)
        last = 100.0 * (run.x[-CYCLE - 1 :] - run.x[-CYCLE - 1])
        cycle.plot(np.arange(CYCLE + 1) * LAW_DT, last, **pen.line())
        slides.append(10.0 * (last.max() - last[-1]))
    labels = {"xlabel": "time (s)", "ylabel": "displacement x (cm)"}
    whole.set(title="Figure 4: displacement for five cycles", xlim=(0.0, DURATION), **labels)
    whole.set_ylim(bottom=-1.0)
    whole.legend(loc="upper left")
    cycle.set(title="Fifth cycle", xlabel="time in the cycle (s)", ylabel="displacement in it (cm)", xlim=(0.0, PERIOD))
    add_note(
        figure,
        f"Mean speed: found {listed(speeds, 3, 'cm/s')}, published {listed(stated, 3, 'cm/s')}: larger by factors of "
        f"{_factors(speeds, stated)} and in the other order. In the fifth cycle the platform slides back by "
        f"{listed(slides, 1, 'mm')}. {DOTTED}",
    )
    return figure


def draw_torque(runs: Runs) -> Any:
    """Fig. 5: motor torque over five cycles under feedback linearisation."""
    figure = new_figure(4.4)
    grid = figure.subplots(2, 2, width_ratios=(1.5, 1.0), sharex="col", sharey="row")
    peaks, stated = [run.metrics["peak_torque"] for run in runs.profiles], _stated("peak_torque")
    for row, run, profile, peak, value in zip(grid, runs.profiles, PROFILES, peaks, stated, strict=True):
        for axes in row:
            axes.plot(run.t[1:], run.torque[1:], **PENS[profile.name].line(linestyle="-", lw=1.0))
            mark_published(axes, -value, "", Pen(INK))
        mark_published(row[0], value, "", Pen(INK))
        mark_published(row[1], value, f"published largest: {value:g} N m", Pen(INK))
        row[0].set(ylabel="torque u (N m)")
        row[0].set_title(f"{profile.name}: largest {peak:.3f} N m")
    grid[0][0].set_title(f"Figure 5: input torque, {PROPOSED.name}: largest {peaks[0]:.3f} N m")
    grid[0][1].set_title("The first second")
    grid[1][0].set(xlabel="time (s)", xlim=(0.0, DURATION))
    grid[1][1].set(xlabel="time (s)", xlim=(0.0, 1.0))
    add_note(
        figure,
        f"Largest torque: found {listed(peaks, 3, 'N m')}, published {listed(stated, 4, 'N m')}: larger by factors of "
        f"{_factors(peaks, stated)} in the same order. The published torques cannot reach the published rates. "
        f"{DOTTED}",
    )
    return figure


def _plant_label(plant: tuple[float, float]) -> str:
    """M and mu of a plant."""
    return f"M = {plant[0]:g} kg, μ = {plant[1]:g}"


def _ends(series: Sequence[Trajectory]) -> str:
    """When runs lost contact, in words."""
    ended = [f"at {run.t[-1]:.2f} s" for run in series if not run.completed]
    if not ended:
        return "all runs last"
    lose = "loses" if len(ended) == 1 else "lose"
    return f"{len(ended)} of {len(series)} runs {lose} contact with the floor, {' and '.join(ended)} (cross)"


def _plot_plants(
    axes: Any, series: Sequence[Trajectory], quantity: Quantity, *, window: slice = slice(None), order: float = 0.1
) -> None:
    """A quantity on the three plants, with a cross where a run ends early; `order` of the layers."""
    for i, (run, plant, pen) in enumerate(zip(series, PLANTS, PLANT_PENS, strict=True)):
        values = quantity(run)
        line = pen.line(label=_plant_label(plant), lw=1.0 if window.start else 1.1, zorder=2.0 + order * i)
        axes.plot(run.t[window], values[window], **line)
        if not run.completed:
            axes.plot(run.t[-1], values[-1], "x", color=pen.colour, ms=6, mew=1.6, clip_on=False, zorder=5)


def draw_adaptive_tracking(runs: Runs) -> Any:
    """Fig. 6: rate and angle under the adaptive law (39), over the whole run and in the first swing."""
    stated = published.ADAPTIVE_PEAK_VELOCITY.value
    figure = new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    # The room above the curves is for the insets.
    rows: tuple[tuple[Quantity, Quantity, tuple[float, float], np.ndarray], ...] = (
        (lambda run: run.theta_dot, lambda run: run.reference[:, 1], (-1.2, 19.5), np.arange(0.0, 9.0, 2.0)),
        (
            lambda run: np.degrees(run.theta),
            lambda run: np.degrees(run.reference[:, 0]),
            (-68.0, 255.0),
            np.arange(-60.0, 90.0, 30.0),
        ),
    )
    reference = runs.adaptive[REGULARISED_LAW][0]
    for column, (law, series) in enumerate(runs.adaptive.items()):
        for axes, (quantity, target, limits, ticks) in zip(grid[:, column], rows, strict=True):
            inset = axes.inset_axes((0.12, 0.61, 0.85, 0.37))
            for each in (axes, inset):
                each.plot(reference.t, target(reference), **REFERENCE, label="reference")
                _plot_plants(each, series, quantity)
            axes.set(xlim=(0.0, DURATION), ylim=limits, yticks=ticks)
            inset.set(xlim=(0.0, FIRST_SWING), ylim=(1.15 * min(quantity(reference)), 1.22 * max(quantity(reference))))
            inset.tick_params(labelsize=6.5)
            inset.set_yticks(ticks[::2])
        grid[0][column].set_title(law)
        mark_published(grid[0][column].child_axes[0], stated, f"published largest: {stated:g} rad/s", Pen(INK))
        grid[1][column].set(xlabel="time (s); insets: the first swing")
    grid[0][0].set(title=f"Figure 6: adaptive law (39), {REGULARISED_LAW}", ylabel="rate θ' (rad/s)")
    grid[1][0].set(ylabel="angle θ (deg)")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    peaks = [run.theta_dot.max() for run in runs.adaptive[REGULARISED_LAW]]
    add_note(
        figure,
        f"Largest rate, {REGULARISED_LAW}: found {min(peaks):.2f} to {max(peaks):.2f} rad/s, published {stated:g}. "
        f"{CORRECTED_LAW.capitalize()}, with the torque limit of {TORQUE_LIMIT:g} N m: "
        f"{_ends(runs.adaptive[CORRECTED_LAW])}. {NO_CURVES}.",
    )
    return figure


def draw_adaptive_error(runs: Runs) -> Any:
    """Fig. 7: the errors of angle and rate under the adaptive law."""
    errors: tuple[tuple[str, Quantity], ...] = (
        (r"angle error $\theta - \theta_d$ (mrad)", lambda run: 1e3 * run.error),
        (r"rate error $\dot\theta - \dot\theta_d$ (mrad/s)", lambda run: 1e3 * run.rate_error),
    )
    figure = new_figure(4.8)
    grid = figure.subplots(2, 2, sharex=True)
    for column, (law, series) in enumerate(runs.adaptive.items()):
        for axes, (label, quantity) in zip(grid[:, column], errors, strict=True):
            _plot_plants(axes, series, quantity, order=-0.1)
            axes.set(xlim=(0.0, DURATION))
            if column == 0:
                axes.set_ylabel(label)
        grid[0][column].set_title(law)
        grid[1][column].set_xlabel("time (s)")
    grid[0][0].set_title(f"Figure 7: tracking errors, {REGULARISED_LAW}")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    angles, rates = (
        [max(np.abs(quantity(run)).max() for run in series) for series in runs.adaptive.values()]
        for _, quantity in errors
    )
    add_note(
        figure,
        f"Largest errors: {REGULARISED_LAW} {angles[0]:.2f} mrad and {rates[0]:.1f} mrad/s; {CORRECTED_LAW} "
        f"{angles[1]:.1f} mrad and {rates[1]:.0f} mrad/s, {_ends(runs.adaptive[CORRECTED_LAW])}. In print: no number, "
        "'tracks the planned trajectory accurately', 'the angular velocity will eventually converge to zero'. "
        f"{NO_CURVES}.",
    )
    return figure


def _two_panels(runs: Runs, title: str, label: str, quantity: Quantity, note: str) -> Any:
    """A quantity on the three plants: the regularised law above, the start of the unregularised one below."""
    figure = new_figure(4.3)
    panels = figure.subplots(2, 1)
    for axes, end, (law, series) in zip(panels, (DURATION, CHATTER), runs.adaptive.items(), strict=True):
        _plot_plants(axes, series, quantity, window=slice(1, round(end / LAW_DT) + 1), order=0.0)
        axes.set(ylabel=label, xlim=(0.0, end))
        axes.margins(y=0.08)
        axes.set_title(law if end == DURATION else f"{law}, the first {end:g} s")
    panels[0].set_title(f"{title}, {REGULARISED_LAW}")
    panels[0].legend(loc="upper center", ncols=3, bbox_to_anchor=(0.5, 1.0))
    # Room for the legend.
    low, high = panels[0].get_ylim()
    panels[0].set_ylim(low, high + 0.22 * (high - low))
    panels[1].set(xlabel="time (s)")
    add_note(figure, note)
    return figure


def draw_adaptive_torque(runs: Runs) -> Any:
    """Fig. 8: motor torque under the adaptive law."""
    stated = published.PROPOSED["peak_torque"].value
    found = max(run.metrics["peak_torque"] for run in runs.adaptive[REGULARISED_LAW])
    note = (
        f"Largest torque: {REGULARISED_LAW} {found:.3f} N m. In print: no number here; {stated:g} N m for the law "
        f"(35) on the same profile. {CORRECTED_LAW.capitalize()}, it runs to the limit of {TORQUE_LIMIT:g} N m away "
        f"from the nominal plant, and {_ends(runs.adaptive[CORRECTED_LAW])}. {NO_CURVES}."
    )
    figure = _two_panels(runs, "Figure 8: torque of the law (39)", "torque u (N m)", lambda run: run.torque, note)
    mark_published(figure.axes[0], stated, f"{stated:g} N m", Pen(MUTED))
    return figure


def sliding_variable(run: Trajectory) -> np.ndarray:
    """delta_theta of (37b), rad/s: the error's rate plus Lambda_theta times the error."""
    return run.rate_error + PUBLISHED.Lambda_theta * run.error


def draw_sliding_variable(runs: Runs) -> Any:
    """Fig. 9: the collocated sliding variable delta_theta."""
    found = max(np.abs(sliding_variable(run)).max() for run in runs.adaptive[REGULARISED_LAW])
    note = (
        rf"Largest $|\delta_\theta|$: {REGULARISED_LAW} {1e3 * found:.1f} mrad/s. In print: no number, 'convergence "
        "towards zero'. It returns towards zero after every progressive stage, and the next cycle excites it anew. "
        f"{CORRECTED_LAW.capitalize()}, {_ends(runs.adaptive[CORRECTED_LAW])}. {NO_CURVES}."
    )
    title, label = r"Figure 9: sliding variable $\delta_\theta$ of (37b)", r"$\delta_\theta$ (mrad/s)"
    return _two_panels(runs, title, label, lambda run: 1e3 * sliding_variable(run), note)


def draw_phase_plane(runs: Runs) -> Any:
    """The upper envelopes of the published torques with the published profiles."""
    figure = new_figure(3.7)
    panels = figure.subplots(1, 2, sharey=True)
    peaks, anywhere, stated = [], [], []
    for axes, profile in zip(panels, PROFILES, strict=True):
        pen, numbers = PENS[profile.name], published.RUNS[profile.name]
        torque, peak = numbers["peak_torque"].value, numbers["peak_velocity"].value
        swing = math.radians(numbers["swing"].value)
        envelope = swing_envelope(torque, profile.start, swing)
        degrees, fastest = np.degrees(envelope.theta[::200]), envelope.theta_dot[::200]
        axes.fill_between(degrees, fastest, TOP_RATE, color="#eef1f5", linewidth=0.0)
        axes.plot(degrees, fastest, color=INK, lw=1.6, label="upper envelope for the published torque")
        peaks.append(printed_above(envelope.fastest, 3))
        anywhere.append(printed_above(swing_envelope(torque, -swing, swing).fastest, 3))
        stated.append(peak)
        angle, rate, _ = profile.evaluate(np.linspace(0.0, profile.period, 4001))
        axes.plot(np.degrees(angle), rate, **pen.line(label=f"{profile.name} profile"))
        mark_published(axes, peak, f"published largest rate: {peak:g} rad/s", pen)
        axes.text(0.0, 12.3, "out of reach", ha="center", va="center", fontsize=8.0, color=MUTED, style="italic")
        axes.set(xlabel="angle θ (deg)", xlim=(-62.0, 90.0), ylim=(-1.0, TOP_RATE))
        axes.set_title(f"{profile.name}: |u| ≤ {torque:g} N m")
    panels[0].set_ylabel("rate θ' (rad/s)")
    handles, labels = panels[0].get_legend_handles_labels()
    others, names = panels[1].get_legend_handles_labels()
    figure.legend([*handles, others[1]], [*labels, names[1]], loc="outside upper left", ncols=3)
    add_note(
        figure,
        "With the published torques the pendulum, from rest at the profiles' start, stays below "
        f"{' and '.join(peaks)} rad/s, in any contact and under any law; from rest anywhere within the swing to either "
        f"side below {' and '.join(anywhere)} rad/s (certified, rounded up). Published are "
        f"{listed(stated, 1, 'rad/s')}.",
    )
    return figure


def draw_speed_map(runs: Runs) -> Any:
    """Mean speed over mass and friction for both profiles, and the ratio of the two."""
    figure = new_figure(3.3)
    panels = figure.subplots(1, 3, sharey=True)
    maps = [speed_map(profile, *grid()) for profile in PROFILES]
    M, mu, ratio = maps[0].M, maps[0].mu, speed_ratio(*maps)
    speeds, ratios = np.arange(-0.25, 2.76, 0.25), np.arange(-0.4, 0.91, 0.1)
    columns = (
        (maps[0].profile, maps[0].speed, speeds, "mean speed (cm/s)", (0, 1, 2)),
        (maps[1].profile, maps[1].speed, speeds, "mean speed (cm/s)", (0, 1, 2)),
        ("Ratio of the speeds", ratio, ratios, "proposed / EPC", (-0.4, 0, 0.4, 0.8)),
    )
    for axes, (title, values, levels, label, ticks) in zip(panels, columns, strict=True):
        drawn = axes.contourf(mu, M, values, levels=levels, cmap="cividis")
        figure.colorbar(drawn, ax=axes, location="bottom", aspect=30, shrink=0.95, label=label, ticks=ticks)
        axes.plot(NOMINAL.mu, NOMINAL.M, "*", color="white", mec=INK, mew=0.7, ms=9)
        axes.set(title=title, xscale="log", xlabel="friction coefficient μ")
        axes.grid(False)
    fits = []
    for axes, each, value in zip(panels, maps, _stated("mean_speed"), strict=False):
        axes.contour(mu, M, each.speed, levels=(value,), colors=INK, linestyles="dashed", linewidths=1.2)
        fits.append(each.friction_for(value)[0])
    hatched = {"facecolor": "none", "edgecolor": "white", "hatch": "////", "linewidth": 0.0}
    panels[1].fill_between(mu, M[0], maps[1].least_mass_in_contact, **hatched)
    panels[0].set(ylabel="mass of the platform M (kg)")
    add_note(
        figure,
        "Exact tracking, five cycles; star: nominal plant; dashed: the published speed, which M = 0.5 kg gives at μ = "
        f"{listed(fits, 3, '').strip()}. EPC is faster on all of it (the order turns nowhere; largest "
        f"ratio {np.nanmax(ratio):.2f}); hatched, below M = {maps[1].least_mass_in_contact:.2f} kg, it lifts the "
        f"platform off the floor. White: both all but at rest.",
    )
    return figure


FIGURES: dict[str, Callable[[Runs], Any]] = {
    "fig1_capsule": draw_capsule,
    "fig2_phases": draw_phases,
    "fig3_tracking": draw_tracking,
    "fig4_displacement": draw_displacement,
    "fig5_torque": draw_torque,
    "fig6_adaptive_tracking": draw_adaptive_tracking,
    "fig7_adaptive_error": draw_adaptive_error,
    "fig8_adaptive_torque": draw_adaptive_torque,
    "fig9_sliding_variable": draw_sliding_variable,
    "phase_plane": draw_phase_plane,
    "speed_map": draw_speed_map,
}


def draw_all(directory: Path, progress: Callable[[str], None]) -> list[Path]:
    """Draws every figure as SVG and PNG; repeated runs give identical files.

    Args:
        directory: made if it does not exist.
        progress: called with the name of each figure.

    Returns:
        The files written.

    Raises:
        ImportError: if matplotlib is not installed.
    """
    from baselines.dynamic_programming.figure import draw_optimum
    from baselines.gaits.figure import draw_gaits

    directory.mkdir(parents=True, exist_ok=True)
    runs = Runs()
    figures: dict[str, Callable[[], Any]] = {name: partial(draw, runs) for name, draw in FIGURES.items()}
    figures |= {"gaits": draw_gaits, "optimum": draw_optimum}
    written: list[Path] = []
    with style():
        for name, draw in figures.items():
            progress(name)
            written += save(draw(), directory / name)
    return written
