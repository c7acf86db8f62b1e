"""The criteria of each task: metric, score, baseline and evaluation set."""

from collections.abc import Mapping
from dataclasses import dataclass

from capsule_gym.evaluation.candidates import BASELINE
from capsule_gym.evaluation.episodes import TABLE_METRICS, TASK_METRICS, TableMetric

_OF_TASKS = {metric.name: metric for metric in TASK_METRICS}


@dataclass(frozen=True)
class Criteria:
    """The criteria by which policies of a task are compared.

    Attributes:
        metric: the metric of learning curves.
        unit: unit of the metric and the score.
        suffix: the unit in names of columns.
        weights: weights of the score by metric, the main metric first; the best model of a run has
            the largest weighted sum of the metrics' means.
        baseline: the scripted policy to compare with.
        ranking_set: the frozen set for ranking policies.
    """

    metric: TableMetric
    unit: str
    suffix: str
    weights: dict[str, float]
    baseline: str
    ranking_set: str

    @property
    def column(self) -> str:
        """The column of the metric in evaluations.csv."""
        return f"{self.metric.name}_{self.suffix}"

    @property
    def ascending(self) -> bool:
        """Whether smaller values of the metric are better."""
        return self.weights[self.metric.name] < 0.0

    def score(self, means: Mapping[str, float]) -> float:
        """The score of a policy, from the means of the metrics in `weights`."""
        return sum(weight * means[name] for name, weight in self.weights.items())

    def describe(self, values: Mapping[str, float]) -> str:
        """The metrics in `weights` as a line of text."""
        main, *shares = self.weights
        return ", ".join(
            [f"{values[main]:.2f} {self.unit}", *(f"{name} {values[name]:.1%}" for name in shares)]
        )


CRITERIA = {
    "speed": Criteria(
        TABLE_METRICS["mean_speed"],
        "cm/s",
        "cm_s",
        {"mean_speed": 1.0, "failed": -30.0},
        BASELINE,
        "paper",
    ),
    # A missed goal already counts as a time of 15 s; the weight of `success` adds 15 s.
    "goal": Criteria(
        _OF_TASKS["goal_time"],
        "s",
        "s",
        {"goal_time": -1.0, "success": 15.0, "failed": -15.0},
        "goal-pulses",
        "goal",
    ),
    # A failure counts as an error of 100 %; the error of a command that never settles is large in
    # any case.
    "velocity": Criteria(
        _OF_TASKS["velocity_error"],
        "%",
        "percent",
        {"velocity_error": -1.0, "unsettled": -20.0, "failed": -100.0},
        "velocity-pulses",
        "velocity",
    ),
}
