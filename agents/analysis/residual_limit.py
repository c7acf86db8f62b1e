"""Sweep over the residual limit: PPO on several laws, with more or less torque of its own.

`residual_limit.json` has a run per line: its `arm` (the fields of `Agent`), the training `seed` (null for a law
alone), the `speeds` of its episodes in cm/s, the numbers of those that `failed`, `learning` (steps, mean speed in cm/s
and share of failures of the evaluations during training) and the `revision` that it was trained at.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.analysis.data import Document
from agents.analysis.figures import write_with
from agents.evaluation.episodes import TABLE_METRICS
from agents.evaluation.statistics import estimate, paired_difference
from baselines.drawing import BLUE, GREEN, INK, MUTED, VERMILION, Pen, add_note, new_figure
from baselines.tables import markdown_table

RESULTS = Path(__file__).with_name("residual_limit.json")
SPEED = TABLE_METRICS["mean_speed"]
# By the scripted policy that is the law alone: its name and colour. "" stands for no law.
LAWS = {"adaptive": ("stiff", VERMILION), "compliant": ("compliant", GREEN), "gait-guarded": ("gait", BLUE)}
# By the plants: the row whose settings agents without a law have, the dashes and the marker.
PLANTS: dict[str, tuple[str, Any, str]] = {
    "paper": ("direct-ppo", "-", "o"),
    "wide": ("direct-ppo-wide", (0.0, (5.0, 1.6)), "s"),
}
RECIPES = ("cautious", "bold")


class Agent(NamedTuple):
    """One kind of agent.

    Attributes:
        base: the scripted policy whose law runs inside the step; "" for none.
        plants: the ranges of M and mu, in training and evaluation.
        limit: of the agent's torque, N m; 0.0 for the law alone.
        recipe: one of `RECIPES`; "" for a law alone, or without a law.
    """

    base: str
    plants: str
    limit: float
    recipe: str = ""

    @property
    def alone(self) -> Agent:
        """Its law without an agent."""
        return Agent(self.base, self.plants, 0.0)


# By agent the speeds of its episodes (cm/s) and whether they failed (0.0 or 1.0), both of shape (runs, episodes).
Results = dict[Agent, tuple[np.ndarray, np.ndarray]]


def load(path: Path = RESULTS) -> Results:
    """Reads the results by agent, its training seeds in order."""
    runs: dict[Agent, list[dict[str, Any]]] = {}
    for run in sorted(json.loads(path.read_text(encoding="utf-8"))["runs"], key=lambda run: run["seed"] or 0):
        runs.setdefault(Agent(**run["arm"]), []).append(run)
    found = {}
    for agent, own in runs.items():
        speeds = np.array([run["speeds"] for run in own])
        numbers = np.arange(speeds.shape[1])
        found[agent] = (speeds, np.array([np.isin(numbers, run["failed"]) for run in own], np.float64))
    return found


def document(policies: Sequence[str] = ()) -> Document:
    """The table and the figure of the committed results; there is no choice of policies."""
    results = load()
    return Document({"residual_limit": table(results)}, {"figures/residual_limit": write_with(draw, results)})


def table(results: Results) -> str:
    """Every agent compared with its law alone; the stiff law first, no law last."""
    lines = [["law", "plants", "agent's limit (N m)", "learns", SPEED.label, "failed", "minus the law alone"]]
    for agent in sorted(results, key=lambda agent: (not agent.base, *agent[:3])):
        speeds, failed = results[agent]
        learns, change = agent.recipe or ("-" if agent.base else PLANTS[agent.plants][0]), "-"
        if agent.base and agent != agent.alone:
            difference = paired_difference(speeds, results[agent.alone][0])
            change = SPEED.with_interval(difference.to_dict(), sign=True)
        law = LAWS[agent.base][0] if agent.base else "none (direct)"
        cells = [SPEED.with_interval(estimate(speeds).to_dict()), f"{failed.sum():.0f}/{failed.size}", change]
        lines.append([law, agent.plants, f"{agent.limit:g}", learns, *cells])
    return markdown_table(lines)


def draw(results: Results) -> Any:
    """Speed and failures over the residual limit, a column per recipe.

    Args:
        results: agents that are absent are left out.
    """
    figure = new_figure(5.0)
    grid = figure.subplots(2, len(RECIPES), sharex=True, sharey="row", height_ratios=(1.6, 1.0), squeeze=False)
    limits = sorted({agent.limit for agent in results if agent.base})
    lines = [agent for agent in results if agent.base and agent == agent.alone]
    for (speed, failed), recipe in zip(grid.T, RECIPES, strict=True):
        for n, alone in enumerate(lines):
            kinds = (alone, *(alone._replace(limit=limit, recipe=recipe) for limit in limits))
            shown = [agent for agent in kinds if agent in results]
            # Lines that would lie on each other are a little apart.
            x = [limits.index(agent.limit) + 0.06 * (n - 0.5 * (len(lines) - 1)) for agent in shown]
            (name, colour), (_, dashes, marker) = LAWS[alone.base], PLANTS[alone.plants]
            line = Pen(colour, dashes).line(marker=marker, markersize=3.5)
            found = [estimate(results[agent][0]) for agent in shown]
            shares = [100.0 * results[agent][1].mean(axis=1) for agent in shown]
            speed.plot(x, [each.value for each in found], label=f"{name} law, {alone.plants}", **line)
            failed.plot(x, [share.mean() for share in shares], **line)
            for place, each, share in zip(x, found, shares, strict=True):
                # For a law alone plants are resampled, which is no interval over training seeds.
                if each.resampled == "seeds":
                    speed.plot([place] * 2, [each.low, each.high], color=colour, linewidth=1.0)
                    failed.plot([place] * 2, [share.min(), share.max()], color=colour, linewidth=1.0)
        for agent in (agent for agent in results if not agent.base):
            line = Pen(MUTED, PLANTS[agent.plants][1]).line(linewidth=1.0)
            speed.axhline(estimate(results[agent][0]).value, label=f"no law, {agent.plants}", **line)
            failed.axhline(100.0 * results[agent][1].mean(), **line)
        speed.set(title=f"Learning {recipe}ly", ylim=(0.0, None))
        # Without failures the axis would have ticks of thousandths.
        failed.set_ylim(0.0, max(5.0, failed.get_ylim()[1]))
        failed.set_xticks(range(len(limits)), [f"{limit:g}" for limit in limits])
        failed.set_xlabel("limit of the agent's torque (N m)", color=INK)
    grid[0][0].set_ylabel("mean speed (cm/s)")
    grid[1][0].set_ylabel("failed (%)")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    add_note(
        figure,
        "At 0 the law alone; at 3 N m an agent can replace its torque by any other. 1 M steps each; bars: 95 % over "
        "training seeds (with few of them their range), for failures the range.",
    )
    return figure
