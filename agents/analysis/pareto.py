"""Speed and cost of transport of a policy that observes its energy weight, compared with the known fronts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agents.analysis.data import Document, fronts
from agents.analysis.figures import plot_fronts, write_with
from agents.evaluation.episodes import TABLE_METRICS, evaluate, failures, scores
from agents.evaluation.policies import find_candidate
from agents.evaluation.statistics import Estimate, estimate
from baselines.drawing import BLUE, add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import EvaluationSet, load_set

# Energy weights, cm/J: from the default of the reward to weights at which creeping is optimal.
WEIGHTS = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 20.0)
SPEED, COST = TABLE_METRICS["mean_speed"], TABLE_METRICS["cost_of_transport"]


class Point(NamedTuple):
    """A policy at one energy weight (cm/J): mean speed (cm/s), cost of transport, failed episodes over all episodes."""

    weight: float
    speed: Estimate
    cost: Estimate
    failures: str


def document() -> Document:
    """The table and the figure."""
    points = measure("pareto", load_set("paper"))
    return Document({"table": table(points)}, {"figures/pareto": write_with(draw, points)})


def measure(name: str, evaluation_set: EvaluationSet, weights: Sequence[float] = WEIGHTS) -> list[Point]:
    """Evaluates all runs of a policy at every weight.

    Args:
        name: name of a policy that observes the energy weight.
        evaluation_set: the episodes.
        weights: energy weights, cm/J.

    Raises:
        ValueError: if a run does not observe the weight.
    """
    points = []
    for weight in weights:
        runs = [policy.with_energy_weight(weight) for policy in find_candidate(name).trained]
        episodes = [episode for policy in runs for episode in evaluate(policy, evaluation_set)]
        speed, cost = (estimate(scores(episodes, each.name)) for each in (SPEED, COST))
        points.append(Point(weight, speed, cost, f"{failures(episodes)}/{len(episodes)}"))
    return points


def table(points: Sequence[Point]) -> str:
    """A Markdown table of the points, with the ratio of their cost to that of the best-known gaits at the same speed.

    The gaits' cost is interpolated linearly in the speed; the ratio is a dash outside the range of the gaits' speeds.
    """
    costs, speeds = zip(*fronts()["best-known gaits"], strict=True)
    measured = (f"{each.label} [95 %]" for each in (SPEED, COST))
    rows = [["energy weight (cm/J)", *measured, "over the gaits'", "failures"]]
    for each in points:
        ratio = each.cost.value / np.interp(each.speed.value, speeds, costs, left=np.nan, right=np.nan)
        cells = SPEED.with_interval(each.speed.to_dict()), COST.with_interval(each.cost.to_dict())
        rows.append([f"{each.weight:g}", *cells, f"{ratio:.2f}" if np.isfinite(ratio) else "-", each.failures])
    return markdown_table(rows)


def draw(points: Sequence[Point]) -> Any:
    """Draws speed against cost of transport."""
    figure = new_figure(4.2)
    axes = figure.subplots()
    plot_fronts(axes)
    x, y = np.array([(each.cost.value, each.speed.value) for each in points]).T
    axes.plot(x, y, "o-", color=BLUE, markersize=4.0, linewidth=1.2, label="one policy, which observes the weight")
    axes.set(xlabel="cost of transport", ylabel="mean speed (cm/s)", xlim=(0.0, None), ylim=(0.0, None))
    # Labels on the upper side of the policy's line, away from the fronts, on a patch that hides the grid.
    direction = np.gradient(axes.transData.transform(np.column_stack((x, y))), axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for each, (right, up) in zip(points[::2], direction[::2], strict=True):
        axes.annotate(
            f"{each.weight:g}",
            (each.cost.value, each.speed.value),
            (-11.0 * abs(up), 9.0 * abs(right)),
            textcoords="offset points",
            ha="center",
            va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.3},
        )
    axes.set_title("One policy for every energy weight (cm/J next to the points)")
    axes.legend(loc="lower right")
    add_note(figure, "Interquartile means over all seeds and episodes of the set paper; fronts on the paper's plant.")
    return figure
