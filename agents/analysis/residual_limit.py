"""Sweep over the residual limit: PPO on several laws, with different limits on the agent's torque.

`residual_limit.json` contains one run per line: `arm` (the fields of `Agent`), the training `seed` (null for a law
alone), the `speeds` of the episodes in cm/s, the indices of episodes that `failed`, `learning` (steps, mean speed in
cm/s and share of failures of the evaluations during training) and the git `revision` of the training.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.analysis.data import Document
from agents.evaluation.episodes import TABLE_METRICS
from agents.evaluation.statistics import estimate, paired_difference
from baselines.tables import markdown_table

RESULTS = Path(__file__).with_name("residual_limit.json")
SPEED = TABLE_METRICS["mean_speed"]
# Names of laws in the table, by the scripted policy that runs only the law; "" stands for no law.
LAWS = {"adaptive": "stiff", "compliant": "compliant", "gait-guarded": "gait", "": "none (direct)"}
# The row with the settings of agents without a law, by the distribution of the plants.
DIRECT_ROWS = {"paper": "direct-ppo", "wide": "direct-ppo-wide"}


class Agent(NamedTuple):
    """One kind of agent.

    Attributes:
        base: the scripted policy whose law runs inside the step; "" for none.
        plants: the distribution of M and mu in training and evaluation.
        limit: limit on the agent's torque, N m; 0.0 for the law alone.
        recipe: "cautious" or "bold"; "" for a law alone, or without a law.
    """

    base: str
    plants: str
    limit: float
    recipe: str = ""

    @property
    def alone(self) -> Agent:
        """The law without an agent."""
        return Agent(self.base, self.plants, 0.0)


# Speeds of the episodes (cm/s) and failures (0.0 or 1.0) by agent, both of shape (runs, episodes).
Results = dict[Agent, tuple[np.ndarray, np.ndarray]]


def load(path: Path = RESULTS) -> Results:
    """Reads the results by agent, with training seeds in order."""
    runs: dict[Agent, list[dict[str, Any]]] = {}
    for run in sorted(json.loads(path.read_text(encoding="utf-8"))["runs"], key=lambda run: run["seed"] or 0):
        runs.setdefault(Agent(**run["arm"]), []).append(run)
    found = {}
    for agent, own in runs.items():
        speeds = np.array([run["speeds"] for run in own])
        numbers = np.arange(speeds.shape[1])
        found[agent] = (speeds, np.array([np.isin(numbers, run["failed"]) for run in own], np.float64))
    return found


def document() -> Document:
    """The table of the committed results."""
    return Document({"residual_limit": table(load())})


def table(results: Results) -> str:
    """A Markdown table of every agent compared with its law alone; agents without a law come last.

    Args:
        results: results of the agents and of every law alone; differences are taken plant by plant.
    """
    lines = [["law", "plants", "agent's limit (N m)", "learns", SPEED.label, "failed", "minus the law alone"]]
    for agent in sorted(results, key=lambda agent: (not agent.base, *agent[:3])):
        speeds, failed = results[agent]
        learns, change = agent.recipe or ("-" if agent.base else DIRECT_ROWS[agent.plants]), "-"
        if agent.base and agent != agent.alone:
            difference = paired_difference(speeds, results[agent.alone][0])
            change = SPEED.with_interval(difference.to_dict(), sign=True)
        cells = [SPEED.with_interval(estimate(speeds).to_dict()), f"{failed.sum():.0f}/{failed.size}", change]
        lines.append([LAWS[agent.base], agent.plants, f"{agent.limit:g}", learns, *cells])
    return markdown_table(lines)
