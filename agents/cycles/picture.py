"""Draws steady cycles side by side: angle, speed, normal force and torque over time, and the phase portrait."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.cycles.course import BACKWARD, FORWARD, STICK, Cycle, contact, stretches
from baselines.drawing import BLUE, INK, MUTED, add_note, new_figure
from capsule_gym.evaluation_sets import NOMINAL_PLANT
from capsule_gym.parameters import NOMINAL

SHADES = {FORWARD: "#dcebf5", STICK: "#c9ced6", BACKWARD: "#fbe3d3"}
NAMES = {FORWARD: "slips forward", STICK: "sticks", BACKWARD: "slips backward"}
# Characters of a title, in a panel of a fifth of the width.
TITLE = 17


def draw_cycles(cycles: Sequence[Cycle]) -> Any:
    """The figure, to be called in the house style.

    Args:
        cycles: one to six, the paper's first.
    """
    from matplotlib.patches import Patch

    figure = new_figure(8.2)
    grid = figure.subplots(5, len(cycles), sharey="row", squeeze=False, height_ratios=(1.0, 1.0, 1.0, 1.0, 1.35))
    weight = (NOMINAL_PLANT.M + NOMINAL.m) * NOMINAL.g
    for column, cycle in zip(grid.T, cycles, strict=True):
        course = cycle.course
        angle, speed, press, torque, portrait = column
        for axes in (angle, speed, press, torque):
            for phase, first, last in stretches(contact(course)):
                axes.axvspan(course.t[first], course.t[last], color=SHADES[phase], linewidth=0.0)
            axes.set_xlim(0.0, course.t[-1])
            axes.grid(visible=False)
        angle.plot(course.t, np.degrees(course.theta), color=INK)
        speed.plot(course.t, 100.0 * course.x_dot, color=INK)
        press.plot(course.t[1:], course.normal_force[1:] / weight, color=INK)
        torque.step(course.t, course.torque, color=INK, where="pre", linewidth=1.0)
        speed.axhline(0.0, color=MUTED, linewidth=0.6)
        press.axhline(1.0, color=MUTED, linewidth=0.6)
        torque.axhline(0.0, color=MUTED, linewidth=0.6)
        for axes in (angle, speed, press):
            axes.tick_params(labelbottom=False)
        torque.set_xlabel("time (s)")
        portrait.plot(np.degrees(course.theta), course.theta_dot, color=BLUE)
        portrait.set_xlabel("angle θ (deg)")
        name, _, seed = course.name.partition(" (")
        lines = textwrap.wrap(name, TITLE) + ([f"({seed}"] if seed else [])
        angle.set_title("\n".join(lines), fontsize=8.0)
    labels = ("θ (deg)", "speed x' (cm/s)", "N / ((M + m) g)", "torque u (N m)", "θ' (rad/s)")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    patches = [Patch(color=SHADES[phase], label=name) for phase, name in NAMES.items()]
    figure.legend(handles=patches, loc="outside upper left", ncols=len(patches))
    add_note(
        figure,
        "One steady cycle each on the paper's plant, from where θ is smallest; the time axes differ. A growing θ "
        "pushes the platform forward.",
    )
    return figure
