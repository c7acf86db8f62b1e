"""The criteria of each task: metric, score, baseline and evaluation set."""

from collections.abc import Mapping
from dataclasses import dataclass

from capsule_gym.evaluation.candidates import BASELINE
from capsule_gym.evaluation.episodes import TABLE_METRICS, TASK_METRICS, TableMetric
from capsule_gym.tasks.registry import TASKS

_TASK_METRICS = {metric.name: metric for metric in TASK_METRICS}


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
        texts = [f"{values[main]:.2f} {self.unit}"]
        texts += [f"{name} {values[name]:.1%}" for name in shares]
        return ", ".join(texts)


_SPEED = Criteria(
    metric=TABLE_METRICS["mean_speed"],
    unit="cm/s",
    suffix="cm_s",
    weights={"mean_speed": 1.0, "failed": -30.0},
    baseline=BASELINE,
    ranking_set="paper",
)
# A missed goal already counts as the time of an episode; the weight of `success` adds it again.
_GOAL_TIME = TASKS["goal"].horizon
_GOAL = Criteria(
    metric=_TASK_METRICS["goal_time"],
    unit="s",
    suffix="s",
    weights={"goal_time": -1.0, "success": _GOAL_TIME, "failed": -_GOAL_TIME},
    baseline="goal-pulses",
    ranking_set="goal",
)
# A failure counts as an error of 100 %; the error of a command that never settles is large in any
# case.
_VELOCITY = Criteria(
    metric=_TASK_METRICS["velocity_error"],
    unit="%",
    suffix="percent",
    weights={"velocity_error": -1.0, "unsettled": -20.0, "failed": -100.0},
    baseline="velocity-pulses",
    ranking_set="velocity",
)
CRITERIA = {"speed": _SPEED, "goal": _GOAL, "velocity": _VELOCITY}
