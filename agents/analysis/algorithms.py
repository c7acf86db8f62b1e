"""What the page on algorithms shows: the gait that SAC is caught in, and learning curves of plain Stable-Baselines3."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.analysis.data import Document, Learning
from agents.analysis.figures import PENS, draw_learning, write_with
from agents.analysis.limit_cycle import find_cycle, median_run
from agents.analysis.recording import Recording, record
from agents.evaluation.policies import find_candidate
from baselines.drawing import add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym import load_policy

HERE = Path(__file__).parent
# Trained from the default start; docs/algorithms.md has the command.
ONE_SIDED = HERE / "one_sided.safetensors"
# Written by examples/plain_sb3.py: task, seed, steps, mean speed (cm/s), share of episodes that failed.
CURVES = HERE / "plain_sb3.csv"


def document() -> Document:
    """The cycles as a table and a figure, and the learning curves."""
    one_sided = record(load_policy(ONE_SIDED), name="SAC from the default start")
    cycles = [find_cycle(each) for each in (one_sided, median_run(find_candidate("direct-ppo")))]
    figures = {"cycles": write_with(draw_cycles, cycles), "curves": write_with(draw_learning, read_curves(CURVES))}
    return Document({"cycles": table(cycles)}, {f"figures/algorithms_{name}": write for name, write in figures.items()})


def read_curves(path: Path) -> dict[str, Learning]:
    """The learning curves of a file of examples/plain_sb3.py, by task and training seed."""
    with path.open(encoding="utf-8") as file:
        points = [(task, int(seed), float(steps), float(speed)) for task, seed, steps, speed, _ in csv.reader(file)]
    found: dict[str, Learning] = {}
    for task, seed in dict.fromkeys(point[:2] for point in points):
        steps, speeds = np.array([point[2:] for point in points if point[:2] == (task, seed)]).T
        found.setdefault(task, {})[seed] = steps, speeds
    return found


def table(cycles: Sequence[Recording]) -> str:
    """Angles, period and speed of the cycles, as Markdown."""
    lines = [["policy", "smallest theta (deg)", "largest theta (deg)", "period (s)", "speed (cm/s)"]]
    for cycle in cycles:
        low, high = np.degrees([cycle.theta.min(), cycle.theta.max()])
        period, step = cycle.t[-1], 100.0 * cycle.x[-1]
        lines.append([cycle.name, f"{low:.0f}", f"{high:.0f}", f"{period:.2f}", f"{step / period:.2f}"])
    return markdown_table(lines)


def draw_cycles(cycles: Sequence[Recording]) -> Any:
    """The rate of the pendulum over its angle."""
    figure = new_figure(3.0, 4.6)
    axes = figure.subplots()
    for cycle, pen in zip(cycles, PENS, strict=True):
        axes.plot(np.degrees(cycle.theta), cycle.theta_dot, **pen.line(label=cycle.name))
    axes.plot(-60.0, 0.0, "ko", markersize=4.0, label="default start")
    axes.set(xlabel="angle θ (deg)", ylabel="θ' (rad/s)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    add_note(figure, "One steady cycle each on the paper's plant, clockwise. The upright is at 0.")
    return figure
