"""One policy for every price of energy: its speed and cost of transport at each, beside the fronts of what is known."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from tyro.conf import arg

import capsule_gym
from agents.evaluation.episodes import TABLE_METRICS, evaluate, failures, scores
from agents.evaluation.policies import find_candidate
from agents.evaluation.statistics import Estimate, estimate
from agents.evidence.figures import plot_fronts
from baselines.drawing import BLUE, add_note, new_figure, save, style
from baselines.tables import markdown_table
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.evaluation_sets import load_set
from capsule_gym.files import write_atomically

PROG = "python -m agents.prices"
# cm/J; from what the reward costs by default to where it pays to creep.
WEIGHTS = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 20.0)


SPEED, COST = TABLE_METRICS["mean_speed"], TABLE_METRICS["cost_of_transport"]


class Price(NamedTuple):
    """What a policy makes at one energy weight.

    Attributes:
        weight: cm/J.
        speed: cm/s.
        cost: of transport.
        failures: over all episodes of all seeds.
        episodes: how many these are.
    """

    weight: float
    speed: Estimate
    cost: Estimate
    failures: int
    episodes: int


@dataclass(frozen=True)
class Options:
    """Evaluates a policy that is told the energy weight at many weights, beside the best-known gaits' front.

    Examples:
      python -m agents.prices --markdown docs/prices_tables.md --figure docs/figures/prices
    """

    policy: Annotated[Positional[str], arg(metavar="NAME_OR_PATH")] = "pareto"
    """A checkpoint, all training seeds, or one of its runs."""
    set: Annotated[str, arg(metavar="NAME_OR_PATH")] = "paper"
    """A frozen set, or the path of a JSON file of the same form."""
    markdown: Path | None = None
    """Write the table to this file."""
    figure: Path | None = None
    """Write the figure to this file; its suffix is the figure's own."""


def measure(name: str, set_name: str, weights: Sequence[float] = WEIGHTS) -> list[Price]:
    """Evaluates all runs of a policy at every weight.

    Args:
        name: of a policy that is told the energy weight.
        set_name: of an evaluation set.
        weights: cm/J.

    Raises:
        ValueError: if there is no such policy or set, or the policy is told no weight.
    """
    evaluation_set, policies = load_set(set_name), find_candidate(name).policies
    prices = []
    for weight in weights:
        episodes = []
        for policy in policies:
            if not isinstance(policy, capsule_gym.Policy):
                raise ValueError(f"policy must be a trained one that is told the energy weight, got {name!r}")
            episodes += evaluate(policy.with_energy_weight(weight), evaluation_set)
        speed, cost = (estimate(scores(episodes, measure.name)) for measure in (SPEED, COST))
        prices.append(Price(weight, speed, cost, failures(episodes), len(episodes)))
    return prices


def cost_of_gaits(speed: float) -> float:
    """The cost of transport on the best-known gaits' front at a speed in cm/s, linear between its gaits; NaN beyond."""
    # Here, since numba comes with it, which takes most of a second to import.
    from baselines.gaits.archive import pareto_front

    speeds, costs = zip(*((gait.mean_speed, gait.cost_of_transport) for gait in pareto_front()), strict=True)
    return float(np.interp(speed, speeds, costs, left=np.nan, right=np.nan))


def table(prices: Sequence[Price]) -> str:
    """The table as Markdown."""
    measured = (f"{measure.label} [95 %]" for measure in (SPEED, COST))
    rows = [["energy weight (cm/J)", *measured, "over the gaits'", "failures"]]
    for each in prices:
        ratio = each.cost.value / cost_of_gaits(each.speed.value)
        cells = SPEED.with_interval(each.speed.to_dict()), COST.with_interval(each.cost.to_dict())
        shown = f"{ratio:.2f}" if np.isfinite(ratio) else "-"
        rows.append([f"{each.weight:g}", *cells, shown, f"{each.failures}/{each.episodes}"])
    return markdown_table(rows)


def draw(prices: Sequence[Price], set_name: str) -> Any:
    """Speed against cost of transport."""
    figure = new_figure(4.2)
    axes = figure.subplots()
    plot_fronts(axes)
    axes.plot(
        [each.cost.value for each in prices],
        [each.speed.value for each in prices],
        "o-",
        color=BLUE,
        markersize=4.0,
        linewidth=1.2,
        label="one policy, told the weight",
    )
    axes.set(xlabel="cost of transport", ylabel="mean speed (cm/s)", xlim=(0.0, None), ylim=(0.0, None))
    # Square to the policy's line on its upper side, where neither front is near, on a patch that hides the grid.
    course = np.gradient(axes.transData.transform([(each.cost.value, each.speed.value) for each in prices]), axis=0)
    course /= np.linalg.norm(course, axis=1, keepdims=True)
    for each, (right, up) in zip(prices[::2], course[::2], strict=True):
        axes.annotate(
            f"{each.weight:g}",
            (each.cost.value, each.speed.value),
            (-11.0 * abs(up), 9.0 * abs(right)),
            textcoords="offset points",
            ha="center",
            va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.3},
        )
    axes.set_title("One policy for every price of energy (cm/J beside the points)")
    axes.legend(loc="lower right")
    note = f"Interquartile means over all seeds and episodes of the set {set_name}; fronts on the paper's plant."
    add_note(figure, note)
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    try:
        prices = measure(options.policy, options.set)
    except ValueError as error:
        refuse(PROG, str(error))
    text = table(prices)
    if options.markdown is not None:
        write_atomically(options.markdown, f"<!-- Written by {PROG}: do not edit. -->\n\n{text}\n")
    if options.figure is not None:
        with style():
            save(draw(prices, options.set), options.figure)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
