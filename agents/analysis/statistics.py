"""Tables and figures of the leaderboard's results: performance profiles, learning curves, cost of transport."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from agents.analysis.data import SPEED, Document, Results, gather
from agents.analysis.figures import draw_learning, draw_profiles, draw_transport, write_with
from agents.evaluation import policies as evaluation_policies
from agents.evaluation.episodes import TABLE_METRICS
from agents.evaluation.statistics import learning_curve
from agents.leaderboard.rows import RESULTS, load_rows
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import SET_NAMES, load_set

ROOT = Path(__file__).resolve().parents[2]
METRIC = TABLE_METRICS[SPEED]


def document() -> Document:
    """Tables and figures of the leaderboard's stored results, without new evaluations."""
    rows = load_rows(ROOT / RESULTS, [candidate.name for candidate in evaluation_policies.all_candidates()])
    results = gather(rows, [load_set(name) for name in SET_NAMES], evaluation_policies.CHECKPOINTS)
    return Document({"learning": learning(results)}, figures_of(results))


def figures_of(results: Results) -> dict[str, Callable[[Path], Any]]:
    """The figures for which there is data, by their path in docs/."""
    trained, shown = results.trained, results.shown_sets
    found = {"transport": write_with(draw_transport, results.rows)}
    if trained:
        found["profiles"] = write_with(draw_profiles, trained, shown)
    if results.learning:
        found["learning"] = write_with(draw_learning, results.learning)
    return {f"figures/statistics_{name}": write for name, write in found.items()}


def learning(results: Results) -> str:
    """A Markdown table of the speed at the end of training, and the steps to 90 % of this speed."""
    table = [["policy", "training seeds", "steps", f"{METRIC.label} at the end", "steps to 90 % of that"]]
    for name, runs in results.learning.items():
        curve = learning_curve(list(runs.values()))
        end = {"iqm": curve.value[-1], "low": curve.low[-1], "high": curve.high[-1]}
        reached = curve.x[curve.value >= 0.9 * curve.value[-1]][0]
        table.append([name, str(len(runs)), f"{curve.x[-1]:,.0f}", METRIC.with_interval(end), f"{reached:,.0f}"])
    without = [row.name for row in results.trained if row.name not in results.learning]
    return markdown_table(table) + (f"\n\nWithout committed evaluations: {', '.join(without)}." if without else "")
