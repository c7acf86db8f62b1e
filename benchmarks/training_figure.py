"""The learning curves of `python -m benchmarks.training`: over environment steps, and over seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.statistics import learning_curve
from baselines import drawing
from baselines.drawing import BLUE, GREEN, PURPLE, VERMILION, Pen
from benchmarks.trainers import Run
from capsule_gym.files import replacing

HEIGHT = 3.1
# As the speed chart's.
RESOLUTION = 130
PENS = (
    Pen(BLUE),
    Pen(VERMILION, (0.0, (5.0, 1.6))),
    Pen(GREEN, (0.0, (1.2, 1.6))),
    Pen(PURPLE, (0.0, (5.0, 1.6, 1.2, 1.6))),
)
# The first two are compared, and have bands.
COMPARED = 2


def draw(runs: Mapping[str, Sequence[Run]], note: str) -> Any:
    """The figure, to be called in the house style.

    Args:
        runs: of each contender; the preset and its peer come first.
        note: stands below.
    """
    figure = drawing.new_figure(HEIGHT)
    left, right = figure.subplots(1, 2, sharey=True)
    for n, ((name, own), pen) in enumerate(zip(runs.items(), PENS, strict=False)):
        curve = learning_curve([(run.steps, run.mean_speed) for run in own])
        seconds = np.median([run.seconds for run in own], axis=0)
        for axes, x in ((left, curve.x / 1e6), (right, seconds)):
            if n < COMPARED:
                axes.fill_between(x, curve.low, curve.high, color=pen.colour, alpha=0.15, linewidth=0.0)
            axes.plot(x, curve.value, **pen.line(label=name))
    left.set(xlabel="environment steps (millions)", ylabel="mean speed (cm/s)", xlim=(0.0, None), ylim=(-1.0, None))
    right.set(xlabel="seconds of processor time", xscale="log")
    right.xaxis.set_major_formatter("{x:g}")
    left.set_title("From as many steps")
    right.set_title("In as much time")
    left.legend(loc="upper left")
    drawing.add_note(figure, note)
    return figure


def save(path: Path, runs: Mapping[str, Sequence[Run]], note: str) -> None:
    """Writes the figure as PNG, whole or not at all."""
    with drawing.style():
        figure = draw(runs, note)
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=RESOLUTION, metadata={"Software": None})
