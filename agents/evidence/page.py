"""The tables of the evidence as Markdown, in sections that docs/evidence.md includes one by one."""

from __future__ import annotations

from agents.evaluation.episodes import TABLE_METRICS, TableMetric
from agents.evidence.material import BASE, REFERENCES, Evidence, difference, improvement
from agents.leaderboard.rows import Row
from baselines.tables import markdown_table

COMMAND = "python -m agents.evidence"
SPEED = TABLE_METRICS["mean_speed"]
PROBABILITY = TableMetric("probability", "probability", 2)
LEARNING_FIGURE = "![Mean speed on own draws over steps of training, every seed and their interquartile mean]"


def render(evidence: Evidence) -> str:
    """The text of docs/evidence_tables.md."""
    sections = {
        "failures": _failures(evidence),
        "differences": _differences(evidence),
        "improvement": _improvement(evidence),
        "learning": _learning(evidence),
    }
    parts = [f"<!-- Written by {COMMAND}: do not edit. -->"]
    for name, text in sections.items():
        parts.append(f"<!-- --8<-- [start:{name}] -->\n{text}\n<!-- --8<-- [end:{name}] -->")
    return "\n\n".join(parts) + "\n"


def _failed(row: Row, set_name: str) -> str:
    """The failures over all episodes of all seeds; behind them those of the worst seed, where there are several."""
    failed = row.score(set_name, "failed")
    count = int(failed.sum())
    if not count:
        return f"0/{failed.size}"
    worst = int(failed.sum(axis=1).max())
    seed = f", worst seed {worst}" if len(failed) > 1 else ""
    return f"{count}/{failed.size} ({100.0 * count / failed.size:.1f} %{seed})"


def _failures(evidence: Evidence) -> str:
    names = [each.name for each in evidence.sets]
    table = [["policy", "training seeds", *names]]
    for row in evidence.rows:
        seeds = str(len(row.header["training_seeds"]) or "-")
        table.append([row.name, seeds, *(_failed(row, name) for name in names)])
    return markdown_table(table)


def _differences(evidence: Evidence) -> str:
    table = [["policy", "set", *(f"minus {'the base' if name == BASE else name}" for name in REFERENCES), "base"]]
    for row in evidence.trained:
        for set_name in evidence.shown_sets:
            cells = []
            for name in REFERENCES:
                other = evidence.reference(row, name)
                found = None if other is None else difference(row, other, set_name).to_dict()
                cells.append("-" if found is None else SPEED.with_interval(found, sign=True))
            table.append([row.name, set_name, *cells, row.header["base"] or "-"])
    return markdown_table(table)


def _improvement(evidence: Evidence) -> str:
    """Every policy beside the next of the ranking: whether the order is more than chance."""
    table = [["policy", "over the next of the ranking", *(f"on {name}" for name in evidence.shown_sets)]]
    for row, other in zip(evidence.trained, evidence.trained[1:], strict=False):
        cells = [PROBABILITY.with_interval(improvement(row, other, name).to_dict()) for name in evidence.shown_sets]
        table.append([row.name, other.name, *cells])
    return markdown_table(table)


def _learning(evidence: Evidence) -> str:
    """The figure, and how long each row took to come to nine tenths of where it ended."""
    if not evidence.learning:
        return "No committed run has its evaluations with it yet."
    table = [["policy", "training seeds", "steps", f"{SPEED.label} at the end", "steps to 90 % of that"]]
    for name, learning in evidence.learning.items():
        curve = learning.curve
        end = {"iqm": curve.value[-1], "low": curve.low[-1], "high": curve.high[-1]}
        reached = curve.x[curve.value >= 0.9 * curve.value[-1]][0]
        cells = [f"{curve.x[-1]:,.0f}", SPEED.with_interval(end), f"{reached:,.0f}"]
        table.append([name, str(len(learning.seeds)), *cells])
    without = [row.name for row in evidence.trained if row.name not in evidence.learning]
    note = f"\n\nWithout committed evaluations: {', '.join(without)}." if without else ""
    return f"{LEARNING_FIGURE}(figures/evidence_learning.png)\n\n{markdown_table(table)}{note}"
