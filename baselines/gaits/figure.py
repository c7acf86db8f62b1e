"""Draws the best-known gaits: speed over friction, and the front of speed against cost of transport."""

from __future__ import annotations

from typing import Any

from baselines.archive import GRID
from baselines.drawing import BLUE, GREEN, INK, MUTED, PURPLE, VERMILION, add_note, new_figure
from baselines.gaits.archive import known_gaits, pareto_front
from baselines.gaits.families import FAMILIES
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import TORQUE_LIMIT

COLOURS = (BLUE, VERMILION, GREEN, PURPLE)
MARKS = dict(zip(FAMILIES, "osD", strict=True))


def draw_gaits() -> Any:
    """Draws the figure; to be called within `baselines.drawing.style`."""
    figure = new_figure(3.9)
    speeds, front = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    table = known_gaits().fastest()
    for M, colour in zip(GRID.M, COLOURS, strict=True):
        gaits = [table[M, mu] for mu in GRID.mu]
        speeds.plot(GRID.mu, [gait.mean_speed for gait in gaits], color=colour, label=f"M = {M:g} kg")
        for gait in gaits:
            speeds.plot(gait.mu, gait.mean_speed, color=colour, marker=MARKS[gait.family], markersize=4.5)
    speeds.set(xscale="log", xlabel="friction coefficient μ", ylabel="mean speed over 33 s (cm/s)")
    speeds.set_title(f"Best-known gaits, |u| ≤ {TORQUE_LIMIT:g} N m")
    speeds.set_ylim(bottom=0.0)
    speeds.set_xticks(GRID.mu, [f"{mu:g}" for mu in GRID.mu])
    speeds.set_xticks([], minor=True)
    gaits = pareto_front()
    front.plot([gait.cost_of_transport for gait in gaits], [gait.mean_speed for gait in gaits], color=MUTED, lw=0.8)
    for name in FAMILIES:
        own = [gait for gait in gaits if gait.family == name]
        x, y = [gait.cost_of_transport for gait in own], [gait.mean_speed for gait in own]
        # A family without gaits is in the legend too, since the markers apply to both panels.
        front.plot(x, y, color=INK, label=name, marker=MARKS[name], markersize=4.5, linestyle="none")
    front.set(xlabel="cost of transport", ylabel="mean speed over 33 s (cm/s)")
    front.set_title(f"Speed against cost, M = {NOMINAL.M:g} kg, μ = {NOMINAL.mu:g}")
    front.set_xlim(left=0.0)
    front.set_ylim(bottom=0.0)
    front.legend(loc="lower right", handlelength=1.2)
    handles, labels = speeds.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), columnspacing=1.4, handlelength=2.0)
    add_note(
        figure,
        "Found by search from rest over 33 s, so lower bounds of what is possible. A mark is the family of the fastest "
        "gait: harmonics, a Fourier series of the torque with feedback; bang-bang, full torque with free switching "
        "times and feedback; phase-space, a polynomial of the state without a clock.",
    )
    return figure
