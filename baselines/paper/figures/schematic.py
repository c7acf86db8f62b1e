"""Figures 1 and 2 of the paper, drawn anew: the capsule with its symbols, and the phases of the profile."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from baselines.drawing import BLUE, GREEN, INK, MUTED, PENS, PUBLISHED_DASHES, VERMILION, add_note, new_figure
from baselines.laws.profiles import PROPOSED
from baselines.paper.principles import RESTORING_PHASES
from baselines.paper.printed_profile import ROMAN
from capsule_gym.parameters import NOMINAL

# Of the drawing of the capsule, in lengths of its pendulum.
ANGLE = math.radians(32.0)
PIVOT = (0.0, 0.42)
SHELL_RADIUS, SHELL_HALF = 0.62, 0.95
PLATFORM = (1.9, 0.3)
BALL = 0.12
FLOOR = -0.2
ARROW: dict[str, Any] = {"arrowstyle": "-|>", "shrinkA": 0.0, "shrinkB": 0.0, "mutation_scale": 9.0, "lw": 1.2}


def draw_capsule() -> Any:
    """Fig. 1: the capsule robot, its constants, coordinates and forces."""
    figure = new_figure(3.7)
    axes = figure.subplots()
    axes.set(aspect="equal", xlim=(-2.6, 2.6), ylim=(-0.78, 1.85), title="Figure 1: the vibro-driven capsule")
    axes.axis("off")
    _draw_body(axes)
    _draw_pendulum(axes)
    _draw_coordinates(axes)
    _draw_forces(axes)
    c = NOMINAL
    add_note(
        figure,
        f"Section 5: M = {c.M:g} kg, m = {c.m:g} kg, l = {c.l:g} m, k = {c.k:g} N m/rad, c = {c.c:g} N m s/rad, μ = "
        f"{c.mu:g}, g = {c.g:g} m/s². The ball sits at x \N{MINUS SIGN} l sin θ: a growing θ swings it backwards and "
        "pushes the platform forwards. The motor's torque u (printed as τ too), spring and damper act between pendulum "
        "and "
        "platform; only N and f act from outside.",
    )
    return figure


def _draw_body(axes: Any) -> None:
    """Shell, platform and floor."""
    from matplotlib.patches import FancyBboxPatch, Rectangle

    width, height = PLATFORM
    shell = FancyBboxPatch(
        (-SHELL_HALF, FLOOR + 0.02),
        2.0 * SHELL_HALF,
        1.86,
        boxstyle=f"round,pad=0,rounding_size={SHELL_RADIUS}",
        facecolor="#f6f8fb",
        edgecolor=MUTED,
        linewidth=1.0,
        linestyle=(0.0, (5.0, 2.0)),
    )
    axes.add_patch(shell)
    axes.add_patch(
        Rectangle((-0.5 * width + 0.18, FLOOR + 0.02), width - 0.36, height, facecolor="#dbe3ee", edgecolor=INK, lw=1.2)
    )
    axes.plot([-2.5, 2.5], [FLOOR, FLOOR], color=INK, lw=1.4)
    for x in np.arange(-2.45, 2.5, 0.14):
        axes.plot([x, x - 0.09], [FLOOR, FLOOR - 0.09], color=MUTED, lw=0.7)
    axes.text(0.0, FLOOR + 0.17, "platform, M", ha="center", va="center")
    axes.annotate("massless shell", (0.78, 1.48), (1.5, 1.62), va="center", color=MUTED, arrowprops=_lead())


def _lead() -> dict[str, Any]:
    """The thin line from a word to what it names."""
    return {"arrowstyle": "-", "color": MUTED, "lw": 0.7, "shrinkA": 2.0, "shrinkB": 0.0}


def _draw_pendulum(axes: Any) -> None:
    """Pivot, rod, ball, spring and damper."""
    from matplotlib.patches import Circle

    x, y = PIVOT
    ball = (x - math.sin(ANGLE), y + math.cos(ANGLE))
    axes.plot([x, x], [FLOOR + 0.32, y], color=INK, lw=3.0, solid_capstyle="butt")
    axes.plot([x, x], [y, y + 1.3], color=MUTED, lw=0.8, linestyle=(0.0, (5.0, 2.5)))
    axes.plot([x, ball[0]], [y, ball[1]], color=BLUE, lw=2.6, solid_capstyle="round")
    axes.add_patch(Circle(ball, BALL, facecolor=BLUE, edgecolor=INK, lw=1.0, zorder=3))
    axes.add_patch(Circle(PIVOT, 0.055, facecolor="white", edgecolor=INK, lw=1.2, zorder=4))
    edge = (ball[0] - BALL * math.cos(0.15), ball[1] + BALL * math.sin(0.15))
    axes.annotate("ball, m", edge, (-1.62, 1.42), va="center", ha="center", arrowprops=_lead())
    axes.text(x - 0.5 * math.sin(ANGLE) - 0.13, y + 0.5 * math.cos(ANGLE) + 0.04, "l", style="italic", ha="center")
    # A spiral about the pivot stands for the torsional spring.
    turn = np.linspace(0.0, 5.0 * math.pi, 200)
    radius = 0.08 + 0.0095 * turn
    axes.plot(x + radius * np.cos(turn), y + radius * np.sin(turn), color=GREEN, lw=0.9)
    axes.annotate(
        "spring k and damper c\nat the pivot", (x + 0.22, y - 0.03), (1.5, 0.5), va="center", color=GREEN,
        arrowprops={**_lead(), "color": GREEN},
    )  # fmt: skip


def _draw_coordinates(axes: Any) -> None:
    """Theta from the upright, x from the start."""
    x, y = PIVOT
    # Up to the rod, whose half width is not crossed.
    last = ANGLE - 0.03
    arc = np.linspace(0.0, last - 0.06, 40)
    axes.plot(x - 0.82 * np.sin(arc), y + 0.82 * np.cos(arc), color=INK, lw=1.0)
    tail, tip = ((x - 0.82 * math.sin(angle), y + 0.82 * math.cos(angle)) for angle in (last - 0.08, last))
    axes.annotate("", tip, tail, arrowprops={**ARROW, "color": INK, "lw": 0.8})
    axes.text(x - 0.26, y + 0.9, "θ", ha="center", va="bottom", fontsize=9.5)
    axes.plot([x, x], [FLOOR - 0.14, FLOOR - 0.52], color=MUTED, lw=0.8)
    axes.plot([-2.0, -2.0], [FLOOR - 0.14, FLOOR - 0.52], color=MUTED, lw=0.8)
    axes.annotate("", (x, FLOOR - 0.42), (-2.0, FLOOR - 0.42), arrowprops={**ARROW, "color": INK})
    axes.text(-1.0, FLOOR - 0.38, "x", ha="center", va="bottom", style="italic")
    axes.text(-2.0, FLOOR - 0.54, "x = 0", ha="center", va="top", color=MUTED, fontsize=7.5)


def _draw_forces(axes: Any) -> None:
    """The motor's torque, gravity, the normal force and friction."""
    from matplotlib.patches import FancyArrowPatch

    x, y = PIVOT
    torque = FancyArrowPatch(
        (x + 0.4, y - 0.1), (x + 0.16, y + 0.38), connectionstyle="arc3,rad=0.45", color=VERMILION, **ARROW
    )
    axes.add_patch(torque)
    axes.text(x + 0.46, y + 0.26, "u", color=VERMILION, style="italic", fontsize=9.5)
    ball = (x - math.sin(ANGLE), y + math.cos(ANGLE))
    axes.annotate("", (ball[0], ball[1] - 0.5), (ball[0], ball[1] - BALL), arrowprops={**ARROW, "color": VERMILION})
    axes.text(ball[0] - 0.07, ball[1] - 0.42, "m g", color=VERMILION, ha="right", style="italic")
    axes.annotate("", (0.5, FLOOR), (0.5, FLOOR - 0.48), arrowprops={**ARROW, "color": VERMILION})
    axes.text(0.56, FLOOR - 0.46, "N", color=VERMILION, style="italic", va="bottom")
    axes.annotate("", (0.8, FLOOR + 0.08), (1.5, FLOOR + 0.08), arrowprops={**ARROW, "color": VERMILION})
    axes.text(1.56, FLOOR + 0.08, "f, sliding forwards", color=VERMILION, va="center")


def draw_phases() -> Any:
    """Fig. 2: the seven phases of the profile (9), with its times and amplitudes; each phase as wide as the next."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    pen, count = PENS[PROPOSED.name], len(PROPOSED.segments)
    V1, P2, P3 = 1.0, 0.36, 0.3
    levels = [(0.0, V1), (V1, V1), (V1, P2), (P2, 0.0), (0.0, -P3), (-P3, -P3), (-P3, 0.0)]
    axes.axvspan(count - RESTORING_PHASES, count, color="#eef1f5", linewidth=0.0, zorder=0.5)
    for n, (begin, end) in enumerate(levels):
        s = np.linspace(0.0, 1.0, 101)
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
    for left, right, name in ((0, restoring, "progressive stage"), (restoring, count, "restoring stage")):
        axes.annotate(
            "",
            (left + 0.04, -0.44),
            (right - 0.04, -0.44),
            arrowprops={**ARROW, "arrowstyle": "<|-|>", "color": INK, "lw": 0.8},
        )
        axes.text(0.5 * (left + right), -0.42, name, ha="center", va="bottom")
    times = ", ".join(f"{t:g}" for t in PROPOSED.times)
    add_note(
        figure,
        f"t₁ to t₇ of Table 1: {times} s. The amplitudes are calibrated: P₁ω = {PROPOSED.segments[1].offset:g}, P₂ = "
        f"{PROPOSED.segments[3].offset:.3f}, P₃ = {PROPOSED.restoring_speed:.3f} rad/s, the last by closure. III and "
        "IV to "
        "VII as built: the printed formulas are neither continuous nor closed.",
    )
    return figure
