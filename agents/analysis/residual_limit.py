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
from baselines.evaluation.episodes import TABLE_METRICS
from baselines.evaluation.statistics import estimate, paired_difference
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


def document() -> Document:
    """A table of every agent compared with its law alone, plant by plant; agents without a law come last."""
    runs: dict[Agent, list[dict[str, Any]]] = {}
    for run in sorted(json.loads(RESULTS.read_text(encoding="utf-8"))["runs"], key=lambda run: run["seed"] or 0):
        runs.setdefault(Agent(**run["arm"]), []).append(run)
    speeds = {agent: np.array([run["speeds"] for run in own]) for agent, own in runs.items()}
    lines = [["law", "plants", "agent's limit (N m)", "learns", SPEED.label, "failed", "minus the law alone"]]
    for agent in sorted(runs, key=lambda agent: (not agent.base, *agent[:3])):
        learns, change = agent.recipe or ("-" if agent.base else DIRECT_ROWS[agent.plants]), "-"
        alone = Agent(agent.base, agent.plants, 0.0)
        if agent.base and agent != alone:
            difference = paired_difference(speeds[agent], speeds[alone])
            change = SPEED.with_interval(difference.to_dict(), sign=True)
        failed = f"{sum(len(run['failed']) for run in runs[agent])}/{speeds[agent].size}"
        cells = [SPEED.with_interval(estimate(speeds[agent]).to_dict()), failed, change]
        lines.append([LAWS[agent.base], agent.plants, f"{agent.limit:g}", learns, *cells])
    return Document({"residual_limit": markdown_table(lines)})
