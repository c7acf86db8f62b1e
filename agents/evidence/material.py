"""What the evidence is made of: the rows' results, the seeds' learning curves, and the fronts beside them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from agents.evaluation.policies import BASELINE
from agents.evaluation.statistics import (
    Curve,
    Estimate,
    estimate,
    learning_curve,
    paired_difference,
    performance_profile,
    probability_of_improvement,
)
from agents.leaderboard.page import RANKING_SET
from agents.leaderboard.rows import Row
from agents.training.presets import EVALUATED, EVALUATIONS
from capsule_gym.evaluation_sets import EvaluationSet

SPEED = "mean_speed"
# What a policy is compared with: by its name, or what its residual is added to.
BASE = "its base"
REFERENCES = (BASELINE, "direct-ppo", BASE)
# The sets whose plants are drawn and do not jump: the paper's ranges and the wide ones.
SHOWN_SETS = ("paper", "wide")
PROFILE_POINTS = 101


@dataclass(frozen=True)
class Learning:
    """How the runs of a row learnt, on plants of their own draws.

    Attributes:
        seeds: by training seed the steps and mean speeds (cm/s) of its evaluations.
    """

    seeds: dict[int, tuple[np.ndarray, np.ndarray]]

    @cached_property
    def curve(self) -> Curve:
        """The interquartile mean over the seeds."""
        return learning_curve(list(self.seeds.values()))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is shown.

    Attributes:
        rows: the fastest on the ranking set first.
        sets: that they were evaluated on.
        learning: by the row's name; rows whose runs were committed without their evaluations are left out.
    """

    rows: tuple[Row, ...]
    sets: tuple[EvaluationSet, ...]
    learning: dict[str, Learning]

    @property
    def trained(self) -> list[Row]:
        """The rows that were learnt."""
        return [row for row in self.rows if row.trained]

    @property
    def shown_sets(self) -> list[str]:
        """The sets of the comparisons."""
        return [each.name for each in self.sets if each.name in SHOWN_SETS]

    def reference(self, row: Row, reference: str) -> Row | None:
        """What a row is compared with; None where there is no such row, or it is the row itself.

        Args:
            row: a trained one.
            reference: one of `REFERENCES`.
        """
        name = row.header["base"] if reference == BASE else reference
        return next((each for each in self.rows if each.name == name != row.name), None)


def gather(rows: Sequence[Row], sets: Sequence[EvaluationSet], checkpoints: Path) -> Evidence:
    """Puts the evidence together.

    Args:
        rows: in any order.
        sets: that they were evaluated on, the ranking set among them.
        checkpoints: the folder with NAME/seed-N/evaluations.csv.

    Raises:
        ValueError: if a row was evaluated on other sets, or a run's evaluations cannot be read.
    """
    for row in rows:
        for each in sets:
            row.check_set(each)
    ranked = sorted(rows, key=lambda row: (-estimate(row.score(RANKING_SET, SPEED)).value, row.name))
    learning = {row.name: read_learning(checkpoints / row.name) for row in ranked if row.trained}
    return Evidence(tuple(ranked), tuple(sets), {name: each for name, each in learning.items() if each.seeds})


def read_learning(folder: Path) -> Learning:
    """The evaluations that the runs of a checkpoint made while they trained, as far as they were committed.

    Args:
        folder: of the checkpoint, with seed-0, seed-1, .. inside.

    Raises:
        ValueError: if a file is not what a training run writes.
    """
    found = {
        int(path.parent.name.removeprefix("seed-")): read_evaluations(path)
        for path in sorted(folder.glob(f"seed-*/{EVALUATIONS}"))
    }
    return Learning(dict(sorted(found.items())))


def read_evaluations(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The steps and the mean speeds (cm/s) of the evaluations that a run made while it trained.

    Args:
        path: its evaluations.csv.

    Raises:
        ValueError: if the file is not what a training run writes.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            # Where a stage of a run ends it may be evaluated twice: the last line counts.
            lines = {int(line[EVALUATED]): float(line["mean_speed_cm_s"]) for line in csv.DictReader(file)}
        steps, speeds = np.array(sorted(lines.items()), np.float64).T
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} must be what a training run writes, got {type(error).__name__}: {error}") from error
    return steps, speeds


def difference(row: Row, reference: Row, set_name: str) -> Estimate:
    """The paired difference of the mean speed, cm/s."""
    return paired_difference(row.score(set_name, SPEED), reference.score(set_name, SPEED))


def improvement(row: Row, other: Row, set_name: str) -> Estimate:
    """The probability that one row is faster than another on the same episode."""
    return probability_of_improvement(row.score(set_name, SPEED), other.score(set_name, SPEED))


def improvements(rows: Sequence[Row], set_name: str) -> dict[tuple[str, str], Estimate]:
    """The probabilities that one row is faster than another, for every two; each pair is computed once."""
    found = {}
    for i, row in enumerate(rows):
        for other in rows[i + 1 :]:
            there = improvement(row, other, set_name)
            found[row.name, other.name] = there
            back = Estimate(1.0 - there.value, 1.0 - there.high, 1.0 - there.low, there.resampled)
            found[other.name, row.name] = back
    return found


def profile(row: Row, set_name: str, fastest: float) -> Curve:
    """The share of episodes that are faster than a speed, from 0 to the fastest (cm/s)."""
    return performance_profile(row.score(set_name, SPEED), np.linspace(0.0, fastest, PROFILE_POINTS))


def fronts() -> dict[str, list[tuple[float, float]]]:
    """What is known of the nominal plant: by name pairs of cost of transport and mean speed (cm/s), slowest first."""
    # Here, since numba comes with it, which takes most of a second to import.
    from baselines.dynamic_programming.archive import optimal_front
    from baselines.gaits.archive import pareto_front

    gaits = [(gait.cost_of_transport, gait.mean_speed) for gait in pareto_front()]
    return {"best-known gaits": gaits, "optimum": optimal_front()}
