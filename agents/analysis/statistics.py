"""Tables and figures of the leaderboard's results: learning curves, cost of transport."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from agents.analysis.data import SPEED, Document, Learning, rank, read_learning
from agents.analysis.figures import draw_learning, draw_transport, write_with
from agents.leaderboard.rows import RESULTS, Row, load_rows
from baselines.evaluation.episodes import TABLE_METRICS
from baselines.evaluation.policies import CHECKPOINTS, all_candidates
from baselines.evaluation.statistics import learning_curve
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import SET_NAMES, load_set

ROOT = Path(__file__).resolve().parents[2]


def document() -> Document:
    """Tables and figures of the leaderboard's stored results, without new evaluations."""
    rows = load_rows(ROOT / RESULTS, [candidate.name for candidate in all_candidates()])
    rows = rank(rows, [load_set(name) for name in SET_NAMES])
    trained = [row for row in rows if row.trained]
    learning = {row.name: read_learning(CHECKPOINTS / row.name) for row in trained}
    figures = {
        "statistics_transport": write_with(draw_transport, rows),
        "statistics_learning": write_with(draw_learning, {name: runs for name, runs in learning.items() if runs}),
    }
    return Document({"learning": table(trained, learning)}, figures)


def table(trained: Sequence[Row], learning: Mapping[str, Learning]) -> str:
    """A Markdown table of the speed at the end of training, and the steps to 90 % of this speed."""
    metric, without = TABLE_METRICS[SPEED], [row.name for row in trained if not learning[row.name]]
    lines = [["policy", "training seeds", "steps", f"{metric.label} at the end", "steps to 90 % of that"]]
    for row in trained:
        if runs := learning[row.name]:
            curve = learning_curve(list(runs.values()))
            end = {"iqm": curve.value[-1], "low": curve.low[-1], "high": curve.high[-1]}
            reached = curve.x[curve.value >= 0.9 * curve.value[-1]][0]
            cells = f"{curve.x[-1]:,.0f}", metric.with_interval(end), f"{reached:,.0f}"
            lines.append([row.name, str(len(runs)), *cells])
    return markdown_table(lines) + (f"\n\nWithout committed evaluations: {', '.join(without)}." if without else "")
