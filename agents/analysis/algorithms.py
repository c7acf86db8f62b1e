"""The one-sided gait that SAC learns from the default start, and learning curves of unmodified Stable-Baselines3."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.analysis.data import Document
from agents.analysis.figures import PENS, write_with
from agents.analysis.limit_cycle import find_cycle, median_run
from agents.analysis.recording import Recording, record
from agents.evaluation.policies import find_candidate
from baselines.drawing import add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym import load_policy

# Policy trained from the default start; docs/algorithms.md contains the command.
ONE_SIDED = Path(__file__).with_name("one_sided.safetensors")
# Written by examples/plain_sb3.py: task, training seed, steps, speed (cm/s), share of episodes that failed.
CURVES = Path(__file__).with_name("plain_sb3.csv")


def document() -> Document:
    """The table and figure of the limit cycles, and the figure of the learning curves."""
    one_sided = record(load_policy(ONE_SIDED), name="SAC from the default start")
    cycles = [find_cycle(each) for each in (one_sided, median_run(find_candidate("direct-ppo")))]
    figures = {
        "figures/algorithms_cycles": write_with(draw_cycles, cycles),
        "figures/algorithms_curves": write_with(draw_curves, CURVES),
    }
    return Document({"cycles": table(cycles)}, figures)


def table(cycles: Sequence[Recording]) -> str:
    """A Markdown table of the cycles' angles, periods and speeds."""
    lines = [["policy", "smallest theta (deg)", "largest theta (deg)", "period (s)", "speed (cm/s)"]]
    for cycle in cycles:
        low, high = np.degrees([cycle.theta.min(), cycle.theta.max()])
        period, step = cycle.t[-1], 100.0 * cycle.x[-1]
        lines.append([cycle.name, f"{low:.0f}", f"{high:.0f}", f"{period:.2f}", f"{step / period:.2f}"])
    return markdown_table(lines)


def draw_cycles(cycles: Sequence[Recording]) -> Any:
    """Draws the angular velocity of the pendulum over its angle."""
    figure = new_figure(3.0, 4.6)
    axes = figure.subplots()
    for cycle, pen in zip(cycles, PENS, strict=True):
        axes.plot(np.degrees(cycle.theta), cycle.theta_dot, **pen.line(label=cycle.name))
    axes.plot(-60.0, 0.0, "ko", markersize=4.0, label="default start")
    axes.set(xlabel="angle θ (deg)", ylabel="θ' (rad/s)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    add_note(figure, "One steady cycle each on the paper's plant, clockwise. The upright is at 0.")
    return figure


def draw_curves(path: Path) -> Any:
    """Draws the mean speed over the training steps, for one run per task."""
    figure = new_figure(2.6, 4.6)
    axes = figure.subplots()
    with path.open(newline="", encoding="utf-8") as file:
        points = list(csv.reader(file))
    for task, pen in zip(dict.fromkeys(task for task, *_ in points), PENS, strict=True):
        curve = np.array([[int(at) / 1e6, float(speed)] for name, _, at, speed, _ in points if name == task])
        axes.plot(*curve.T, **pen.line(label=task))
    axes.set(xlabel="steps of training (millions)", ylabel="speed (cm/s)", xlim=0.0, ylim=0.0)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    add_note(figure, "One run each; mean over 16 plants, from the default start.")
    return figure
