"""Data of the leaderboard's analysis: ranked rows and learning curves."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.criteria import CRITERIA
from agents.leaderboard.rows import Row
from agents.training.config import EVALUATIONS
from baselines.evaluation.statistics import estimate
from capsule_gym.evaluation_sets import EvaluationSet

SPEED = "mean_speed"
# Evaluations on validation plants during training, by training seed: steps and the values of the task's metric.
Learning = dict[int, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Document:
    """The output of the analysis for one page of the documentation.

    Attributes:
        sections: Markdown by the name under which the page includes it.
        figures: functions that write a figure to a path without suffix, by the figure's name.
    """

    sections: dict[str, str]
    figures: dict[str, Callable[[Path], Any]] = field(default_factory=dict)


def rank(rows: Sequence[Row], sets: Sequence[EvaluationSet], task: str = "speed") -> list[Row]:
    """Sorts rows of a task by the metric on its ranking set, which must be among the sets, the best first.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    for row in rows:
        for each in sets:
            row.check_set(each)
    criteria = CRITERIA[task]
    values = {
        row.name: estimate(row.score(criteria.ranking_set, criteria.metric.name), mean=True).value for row in rows
    }
    return sorted(rows, key=lambda row: criteria.rank(values[row.name], row.name))


def read_learning(folder: Path, task: str = "speed") -> Learning:
    """Reads the evaluations of the runs in seed-0, seed-1, .. of a folder, or those of the run in the folder itself.

    Raises:
        ValueError: if a file is not the log of a training run.
    """
    runs = {int(path.parent.name.removeprefix("seed-")): path for path in folder.glob(f"seed-*/{EVALUATIONS}")}
    runs |= {0: folder / EVALUATIONS} if (folder / EVALUATIONS).is_file() else {}
    found = {}
    for seed, path in sorted(runs.items()):
        try:
            with path.open(newline="", encoding="utf-8") as file:
                # A run may be evaluated twice at the end of a stage; the last line is used.
                lines = {int(line["steps"]): float(line[CRITERIA[task].column]) for line in csv.DictReader(file)}
            steps, values = np.array(sorted(lines.items()), np.float64).T
        except (KeyError, TypeError, ValueError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise ValueError(f"{path} must be the log of a training run, got {reason}") from error
        found[seed] = steps, values
    return found
