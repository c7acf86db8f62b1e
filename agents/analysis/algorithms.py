"""The one-sided gait that SAC converges to from the default start, next to the gait of PPO."""

from __future__ import annotations

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

# Trained from the default start; docs/algorithms.md has the command.
ONE_SIDED = Path(__file__).with_name("one_sided.safetensors")


def document() -> Document:
    """The cycles as a table and a figure."""
    one_sided = record(load_policy(ONE_SIDED), name="SAC from the default start")
    cycles = [find_cycle(each) for each in (one_sided, median_run(find_candidate("direct-ppo")))]
    return Document({"cycles": table(cycles)}, {"figures/algorithms_cycles": write_with(draw_cycles, cycles)})


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
