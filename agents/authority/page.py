"""The tables of the study as Markdown, in sections that docs/when_a_law_helps.md includes."""

from __future__ import annotations

import numpy as np

from agents.authority.design import DIRECT, RECIPES, Arm, direct
from agents.authority.results import Results
from agents.evaluation.episodes import TABLE_METRICS
from agents.evaluation.statistics import estimate, learning_curve, paired_difference
from baselines.tables import markdown_table

COMMAND = "python -m agents.authority"
SPEED = TABLE_METRICS["mean_speed"]
# Of a law with an agent beside the direct one, while they learn, N m; and at which shares of the budget they are shown.
SHOWN_BASE, SHOWN_LIMIT = "gait-guarded", 0.75
SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)


def render(results: Results) -> str:
    """The text of docs/when_a_law_helps_tables.md."""
    sections = {"design": _design(results), "authority": _authority(results), "learning": _learning(results)}
    parts = [f"<!-- Written by {COMMAND}: do not edit. -->"]
    for name, text in sections.items():
        parts.append(f"<!-- --8<-- [start:{name}] -->\n{text}\n<!-- --8<-- [end:{name}] -->")
    return "\n\n".join(parts) + "\n"


def _design(results: Results) -> str:
    seeds = [run.seed for run in results.runs if run.seed is not None]
    return (
        f"{len(seeds)} trainings of {results.steps:,} steps, training seeds {', '.join(map(str, sorted(set(seeds))))}; "
        f"{len(results.runs[0].speeds)} plants of each kind."
    )


def _failures(results: Results, arm: Arm) -> str:
    failed = results.failed(arm)
    return f"{int(failed.sum())}/{failed.size}"


def _authority(results: Results) -> str:
    """Every kind of agent beside its law alone."""
    table = [["law", "plants", "agent's limit (N m)", "learns", SPEED.label, "failed", "minus the law alone"]]
    present = results.arms()
    for arm in sorted(present, key=lambda arm: (_order(arm), arm.plants, arm.limit)):
        speeds = results.speeds(arm)
        change = "-"
        if arm.base and arm != arm.alone:
            change = SPEED.with_interval(paired_difference(speeds, results.speeds(arm.alone)).to_dict(), sign=True)
        speed = SPEED.with_interval(estimate(speeds).to_dict())
        table.append([arm.label, arm.plants, f"{arm.limit:g}", _learns(arm), speed, _failures(results, arm), change])
    return markdown_table(table)


def _order(arm: Arm) -> tuple[int, str]:
    """The stiff law first, no law last."""
    return (0 if arm.base else 1, arm.base)


def _learning(results: Results) -> str:
    """How fast agents come to what they reach, with the gait below them and without."""
    steps = [round(share * results.steps) for share in SHARES]
    table = [["law", "plants", "learns", *(f"{each / 1e6:g} M steps" for each in steps)]]
    for plants in DIRECT:
        on_law = [Arm(SHOWN_BASE, plants, SHOWN_LIMIT, recipe) for recipe in RECIPES]
        for arm in (*on_law, direct(plants)):
            runs = results.of(arm)
            if not runs:
                continue
            found = [np.array(run.learning) for run in runs]
            curve = learning_curve([(each[:, 0], each[:, 1]) for each in found])
            # An evaluation comes with the first update after it is due.
            shown = np.searchsorted(curve.x, steps).clip(max=len(curve.x) - 1)
            table.append([arm.label, plants, _learns(arm), *(SPEED.format(curve.value[n]) for n in shown)])
    return markdown_table(table)


def _learns(arm: Arm) -> str:
    return arm.recipe or ("-" if arm.base else DIRECT[arm.plants])
