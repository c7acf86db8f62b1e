"""The limit cycle of a policy on the paper's plant."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from agents.analysis.data import Document
from agents.analysis.figures import write_with
from agents.analysis.recording import Recording, record
from agents.evaluation.policies import BASELINE, Candidate, find_candidate
from baselines.drawing import BLUE, INK, MUTED, add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import NOMINAL_PLANT
from capsule_gym.parameters import NOMINAL

# The paper's law, the fastest policies that learned from reward, and the optimum.
POLICIES = (BASELINE, "residual-on-gait", "residual-on-gait-wide", "residual-identifying", "dp-nominal")
# Length of the search window at the end of the episode, s: slightly more than three of the paper's cycles of 6.6 s.
WINDOW = 20.0
# Phases of the contact by the sign of the displacement.
PHASES = {1: ("slips forward", "#dcebf5"), 0: ("sticks", "#c9ced6"), -1: ("slips backward", "#fbe3d3")}
# Largest number of characters per line of a panel's title.
TITLE = 17


def find_cycle(recording: Recording) -> Recording:
    """Finds the cycle at the end of an episode that is closest to periodic; the result starts at the smallest theta.

    A cycle begins whenever theta rises through the middle of its range.

    Args:
        recording: a recording longer than `WINDOW`.

    Raises:
        ValueError: if the episode failed, or does not contain two cycles in the window.
    """
    t = recording.t
    first = len(t) - 1 - round(WINDOW / (t[1] - t[0]))
    theta = recording.theta[first:]
    middle = 0.5 * (theta.min() + theta.max())
    rises = first + 1 + np.flatnonzero((theta[:-1] < middle) & (theta[1:] >= middle))
    periods = np.diff(rises)
    # The start is moved to the smallest theta in the cycle, so the recording must be longer by up to a period.
    fits = rises[1:] + periods < len(t)
    if recording.failed or not fits.any():
        raise ValueError(f"recording must contain two cycles in its last {WINDOW:g} s, got {recording.name}")
    # Changes of the velocities over a cycle, in units of their standard deviations.
    rates = np.array([recording.theta_dot, recording.x_dot])
    changes = np.abs(np.diff(rates[:, rises])) / rates[:, first:].std(axis=1, keepdims=True)
    i = int(np.where(fits, changes.max(axis=0), np.inf).argmin())
    begin = int(rises[i] + np.argmin(recording.theta[rises[i] : rises[i + 1]]))
    return recording.cut(begin, begin + int(periods[i]))


def document() -> Document:
    """The table and the figure."""
    cycles = [find_cycle(median_run(find_candidate(name))) for name in POLICIES]
    return Document({"shapes": table(cycles)}, {"figures/limit_cycle": write_with(draw, cycles)})


def median_run(candidate: Candidate) -> Recording:
    """Records the training seed with the median speed, or the lower of the two middle ones.

    Args:
        candidate: a policy; if it has several seeds, the recording's name contains the chosen one.
    """
    found = [record(policy, name=candidate.name) for policy in candidate.policies]
    chosen = sorted(range(len(found)), key=lambda i: found[i].x[-1])[(len(found) - 1) // 2]
    if len(found) == 1:
        return found[0]
    return replace(found[chosen], name=f"{candidate.name} (seed {candidate.trained[chosen].training_seed})")


def table(cycles: Sequence[Recording]) -> str:
    """A Markdown table of the cycles.

    Args:
        cycles: recordings of one cycle each; the first is the reference of the ratios.
    """
    lines = [["policy", "period (s)", "step (cm)", "as often", "as far", "speed (cm/s)", "at the limit"]]
    first = cycles[0]
    for recording in cycles:
        period, step = recording.t[-1], recording.x[-1]
        saturated = (np.abs(recording.torque[1:]) >= recording.torque_limit).mean()
        ratios = f"x {first.t[-1] / period:.2f}", f"x {step / first.x[-1]:.2f}"
        numbers = f"{100.0 * step / period:.2f}", f"{100.0 * saturated:.0f} %"
        lines.append([recording.name, f"{period:.2f}", f"{100.0 * step:.2f}", *ratios, *numbers])
    return markdown_table(lines)


def draw(cycles: Sequence[Recording]) -> Any:
    """Draws angle, speed, normal force and torque over time, and the phase portrait, one column per cycle.

    Args:
        cycles: recordings of one cycle each, on the paper's plant.
    """
    from matplotlib.patches import Patch

    figure = new_figure(8.2)
    grid = figure.subplots(5, len(cycles), sharey="row", squeeze=False, height_ratios=(1.0, 1.0, 1.0, 1.0, 1.35))
    weight = (NOMINAL_PLANT.M + NOMINAL.m) * NOMINAL.g
    for column, recording in zip(grid.T, cycles, strict=True):
        angle, speed, load, torque, portrait = column
        t, degrees = recording.t, np.degrees(recording.theta)
        begin = 0
        for phase, group in itertools.groupby(np.sign(np.diff(recording.x)).tolist()):
            end = begin + len(list(group))
            for axes in column[:-1]:
                axes.axvspan(t[begin], t[end], color=PHASES[phase][1], linewidth=0.0)
            begin = end
        for axes in column[:-1]:
            axes.set_xlim(0.0, t[-1])
            axes.grid(visible=False)
            axes.tick_params(labelbottom=axes is torque)
        angle.plot(t, degrees, color=INK)
        speed.plot(t, 100.0 * recording.x_dot, color=INK)
        load.plot(t[1:], recording.normal_force[1:] / weight, color=INK)
        torque.step(t, recording.torque, color=INK, where="pre", linewidth=1.0)
        for axes, level in ((speed, 0.0), (load, 1.0), (torque, 0.0)):
            axes.axhline(level, color=MUTED, linewidth=0.6)
        torque.set_xlabel("time (s)")
        portrait.plot(degrees, recording.theta_dot, color=BLUE)
        portrait.set_xlabel("angle θ (deg)")
        name, _, seed = recording.name.partition(" (")
        angle.set_title("\n".join(textwrap.wrap(name, TITLE) + ([f"({seed}"] if seed else [])), fontsize=8.0)
    labels = ("θ (deg)", "speed x' (cm/s)", "N / ((M + m) g)", "torque u (N m)", "θ' (rad/s)")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    patches = [Patch(color=shade, label=name) for name, shade in PHASES.values()]
    figure.legend(handles=patches, loc="outside upper left", ncols=len(patches))
    add_note(
        figure,
        "One cycle each on the paper's plant, from the smallest θ on; the time axes differ. A growing θ pushes the "
        "platform forward.",
    )
    return figure
