"""Data of the leaderboard's analysis: the rows' episodes, the learning curves of their runs, and the known fronts."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.criteria import CRITERIA, Criteria
from agents.evaluation.statistics import estimate
from agents.leaderboard.rows import Row
from agents.training.config import EVALUATIONS
from baselines.dynamic_programming.archive import optimal_front
from baselines.gaits.archive import pareto_front
from capsule_gym.evaluation_sets import EvaluationSet

SPEED = "mean_speed"
# Sets with random, constant plants: from the paper's ranges and from the wide ranges.
SHOWN_SETS = ("paper", "wide")
# Evaluations on validation plants during training, by training seed: steps and the values of the task's metric.
Learning = dict[int, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Document:
    """The output of the analysis for one page of the documentation.

    Attributes:
        sections: Markdown by the name under which the page includes it.
        figures: functions that write a figure to a path, by this path in docs/.
    """

    sections: dict[str, str] = field(default_factory=dict)
    figures: dict[str, Callable[[Path], Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Results:
    """Rows of the leaderboard with the data of their comparison.

    Attributes:
        rows: rows, the best on the ranking set first.
        sets: the sets on which the rows were evaluated.
        learning: evaluations during training, by the row's name; absent for rows without committed evaluations.
        task: the task of the rows.
    """

    rows: tuple[Row, ...]
    sets: tuple[EvaluationSet, ...]
    learning: dict[str, Learning]
    task: str = "speed"

    @property
    def criteria(self) -> Criteria:
        """The task's criteria."""
        return CRITERIA[self.task]

    @property
    def trained(self) -> list[Row]:
        """The rows of trained policies."""
        return [row for row in self.rows if row.trained]

    @property
    def shown_sets(self) -> list[str]:
        """The names of the sets in comparisons."""
        return [each.name for each in self.sets if each.name in SHOWN_SETS or self.task != "speed"]


def gather(rows: Sequence[Row], sets: Sequence[EvaluationSet], checkpoints: Path, task: str = "speed") -> Results:
    """Ranks rows and reads their learning curves.

    Args:
        rows: rows in any order.
        sets: the sets on which the rows were evaluated, including the ranking set.
        checkpoints: the folder with NAME/seed-N/evaluations.csv.
        task: the task of rows and sets.

    Raises:
        ValueError: if a row was evaluated on other sets, or a run's evaluations cannot be read.
    """
    for row in rows:
        for each in sets:
            row.check_set(each)
    criteria = CRITERIA[task]
    values = {row.name: estimate(row.score(criteria.ranking_set, criteria.metric.name)).value for row in rows}
    ranked = sorted(rows, key=lambda row: criteria.rank(values[row.name], row.name))
    learning = {row.name: read_learning(checkpoints / row.name, task) for row in ranked if row.trained}
    return Results(tuple(ranked), tuple(sets), {name: each for name, each in learning.items() if each}, task)


def read_learning(folder: Path, task: str = "speed") -> Learning:
    """Reads the committed evaluations of a checkpoint's runs.

    Args:
        folder: folder of the checkpoint, with seed-0, seed-1, .. inside.
        task: the task of the runs.

    Raises:
        ValueError: if a file is not the log of a training run.
    """
    paths = {int(path.parent.name.removeprefix("seed-")): path for path in folder.glob(f"seed-*/{EVALUATIONS}")}
    return {seed: read_evaluations(paths[seed], task) for seed in sorted(paths)}


def read_evaluations(path: Path, task: str = "speed") -> tuple[np.ndarray, np.ndarray]:
    """Reads the steps and the values of the task's metric of a run's evaluations.csv.

    Raises:
        ValueError: if the file is not the log of a training run.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            # A run may be evaluated twice at the end of a stage; the last line is used.
            lines = {int(line["steps"]): float(line[CRITERIA[task].column]) for line in csv.DictReader(file)}
        steps, values = np.array(sorted(lines.items()), np.float64).T
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} must be the log of a training run, got {type(error).__name__}: {error}") from error
    return steps, values


def fronts() -> dict[str, list[tuple[float, float]]]:
    """The known Pareto fronts of the nominal plant: pairs of cost of transport and mean speed (cm/s), slowest first."""
    gaits = [(gait.cost_of_transport, gait.mean_speed) for gait in pareto_front()]
    return {"best-known gaits": gaits, "optimum": optimal_front()}
