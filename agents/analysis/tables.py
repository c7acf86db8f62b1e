"""Tables of the leaderboard's analysis: failures, paired differences, probabilities of improvement, learning."""

from __future__ import annotations

from agents.analysis.data import BASE, REFERENCES, Results, difference, improvement
from agents.evaluation.episodes import TABLE_METRICS, TableMetric
from agents.leaderboard.rows import Row
from baselines.tables import markdown_table

SPEED = TABLE_METRICS["mean_speed"]
PROBABILITY = TableMetric("probability", "probability", 2)


def failures(results: Results) -> str:
    """Failures of every row on every set."""
    names = [each.name for each in results.sets]
    table = [["policy", "training seeds", *names]]
    for row in results.rows:
        seeds = str(len(row.header["training_seeds"]) or "-")
        table.append([row.name, seeds, *(_failed(row, name) for name in names)])
    return markdown_table(table)


def _failed(row: Row, set_name: str) -> str:
    """The failures over all episodes of all seeds; of several seeds also those of the worst."""
    failed = row.score(set_name, "failed")
    count, worst = int(failed.sum()), int(failed.sum(axis=1).max())
    if not count:
        return f"0/{failed.size}"
    seed = f", worst seed {worst}" if len(failed) > 1 else ""
    return f"{count}/{failed.size} ({100.0 * count / failed.size:.1f} %{seed})"


def differences(results: Results) -> str:
    """Paired differences of the trained rows to the references."""
    table = [["policy", "set", *(f"minus {'the base' if name == BASE else name}" for name in REFERENCES), "base"]]
    for row in results.trained:
        for set_name in results.shown_sets:
            others = [results.reference(row, name) for name in REFERENCES]
            found = [other and difference(row, other, set_name).to_dict() for other in others]
            cells = [SPEED.with_interval(each, sign=True) if each else "-" for each in found]
            table.append([row.name, set_name, *cells, row.header["base"] or "-"])
    return markdown_table(table)


def improvements(results: Results) -> str:
    """Every trained row compared with the next of the ranking: whether the order is more than chance."""
    table = [["policy", "over the next of the ranking", *(f"on {name}" for name in results.shown_sets)]]
    for row, other in zip(results.trained, results.trained[1:], strict=False):
        cells = [PROBABILITY.with_interval(improvement(row, other, name).to_dict()) for name in results.shown_sets]
        table.append([row.name, other.name, *cells])
    return markdown_table(table)


def learning(results: Results) -> str:
    """Speed at the end of training, and the steps to nine tenths of it."""
    table = [["policy", "training seeds", "steps", f"{SPEED.label} at the end", "steps to 90 % of that"]]
    for name, each in results.learning.items():
        curve = each.curve
        end = {"iqm": curve.value[-1], "low": curve.low[-1], "high": curve.high[-1]}
        reached = curve.x[curve.value >= 0.9 * curve.value[-1]][0]
        cells = [f"{curve.x[-1]:,.0f}", SPEED.with_interval(end), f"{reached:,.0f}"]
        table.append([name, str(len(each.seeds)), *cells])
    without = [row.name for row in results.trained if row.name not in results.learning]
    return markdown_table(table) + (f"\n\nWithout committed evaluations: {', '.join(without)}." if without else "")
