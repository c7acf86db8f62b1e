"""Tables and figures of the leaderboard's results: failures, differences, learning."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from agents.analysis.data import SPEED, Document, Results, gather
from agents.analysis.figures import draw_learning, draw_profiles, draw_transport, write_with
from agents.evaluation import policies as evaluation_policies
from agents.evaluation.episodes import TABLE_METRICS
from agents.evaluation.policies import BASELINE
from agents.evaluation.statistics import learning_curve, paired_difference
from agents.leaderboard.rows import RESULTS, Row, load_rows
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import SET_NAMES, load_set

ROOT = Path(__file__).resolve().parents[2]
METRIC = TABLE_METRICS[SPEED]


def document() -> Document:
    """Tables and figures of the leaderboard's results; nothing is evaluated."""
    rows = load_rows(ROOT / RESULTS, [candidate.name for candidate in evaluation_policies.all_candidates()])
    results = gather(rows, [load_set(name) for name in SET_NAMES], evaluation_policies.CHECKPOINTS)
    sections = {
        "failures": failures(results),
        "differences": differences(results),
        "learning": learning(results),
    }
    return Document(sections, figures_of(results))


def figures_of(results: Results) -> dict[str, Callable[[Path], Any]]:
    """The figures that there is data for, by their path in docs/."""
    trained, shown = results.trained, results.shown_sets
    found = {"transport": write_with(draw_transport, results.rows)}
    if trained:
        found["profiles"] = write_with(draw_profiles, trained, shown)
    if results.learning:
        found["learning"] = write_with(draw_learning, results.learning)
    return {f"figures/statistics_{name}": write for name, write in found.items()}


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
    """Paired differences of the trained rows to the paper's controller, to `direct-ppo` and to the law they run on."""
    rows = {row.name: row for row in results.rows}
    table = [["policy", "set", f"minus {BASELINE}", "minus direct-ppo", "minus the base", "base"]]
    for row in results.trained:
        for set_name in results.shown_sets:
            cells = []
            for name in (BASELINE, "direct-ppo", row.header["base"]):
                other, cell = rows.get(name), "-"
                if other is not None and other is not row:
                    found = paired_difference(row.score(set_name, SPEED), other.score(set_name, SPEED))
                    cell = METRIC.with_interval(found.to_dict(), sign=True)
                cells.append(cell)
            table.append([row.name, set_name, *cells, row.header["base"] or "-"])
    return markdown_table(table)


def learning(results: Results) -> str:
    """Speed at the end of training, and the steps to nine tenths of it."""
    table = [["policy", "training seeds", "steps", f"{METRIC.label} at the end", "steps to 90 % of that"]]
    for name, runs in results.learning.items():
        curve = learning_curve(list(runs.values()))
        end = {"iqm": curve.value[-1], "low": curve.low[-1], "high": curve.high[-1]}
        reached = curve.x[curve.value >= 0.9 * curve.value[-1]][0]
        table.append([name, str(len(runs)), f"{curve.x[-1]:,.0f}", METRIC.with_interval(end), f"{reached:,.0f}"])
    without = [row.name for row in results.trained if row.name not in results.learning]
    return markdown_table(table) + (f"\n\nWithout committed evaluations: {', '.join(without)}." if without else "")
