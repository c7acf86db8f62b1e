"""The output of `python -m baselines.paper`: every result as a table, which the page *The paper* explains."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from baselines.paper import adaptive, principles, proofs, published, selection, tracking
from baselines.paper.adaptive import ERRORS
from baselines.paper.optimal_profiles import Solution, load
from baselines.paper.verdicts import compare_numbers, judge_claims
from baselines.tables import printed_below, text_table

Results = dict[str, Any]
Row = Mapping[str, Any]

WIDTH = 118
# Share of its limit from which a demand counts as binding; the search keeps a reserve of about one percent.
BINDING = 0.98


def compute() -> Results:
    """Computes all results, each by the function that describes it."""
    runs, study = tracking.reproduce(), adaptive.study_adaptive()
    return {
        "numbers": compare_numbers(runs, study),
        "claims": judge_claims(runs, study),
        "runs": runs,
        "adaptive": study,
        "torques": proofs.check_torques(),
        "profile_as_printed": selection.printed_profile(),
        "table_1": selection.evaluate_selection(),
        "demands": principles.evaluate_demands(),
        "lemmas": principles.check_lemmas(),
        "optimal_profiles": load(),
    }


def _cell(value: Any) -> str:
    """A value as text, numbers with four digits."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_cell, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def text(results: Results) -> str:
    """All tables, for a terminal; quantities without a unit are in rad, rad/s, N m, J and cm a cycle, and cm/s."""
    runs, study = results["runs"], results["adaptive"]
    laws, ratio = study["laws"], tracking.speed_ratio(*runs["maps"])
    turned = math.degrees(sum(phase["printed"][2] for phase in results["profile_as_printed"]))
    sections: dict[str, Sequence[Any]] = {
        "Section 5 of the paper: published and found": [_number(row) for row in results["numbers"]],
        "What the paper claims": [
            f"{row['claim']}: {_verdict(row)}. Found: {row['found']}." for row in results["claims"]
        ],
        "Both profiles under feedback linearisation (35)": [
            {"profile": name, "N by": force, **run}
            for name, forces in runs["tracking"].items()
            for force, run in forces.items()
        ],
        "Proof: torque where theta' peaks": [
            {**row, **{name: printed_below(row[name], 3) for name in ("bound", "sticking")}}
            for row in results["torques"]
        ],
        f"Sensitivity: speeds over M in {tracking.M_RANGE} kg, mu in {tracking.MU_RANGE}": [
            {
                "mu for the published speed": tuple(
                    each.friction_for(published.RUNS[each.profile]["mean_speed"].value) for each in runs["maps"]
                ),
                "proposed over EPC, least": float(np.nanmin(ratio)),
                "most": float(np.nanmax(ratio)),
            }
        ],
        f"The profile (9) as printed, {turned:.0f} degrees a cycle, and as built": results["profile_as_printed"],
        "What Table 1 follows from (Sect. 3.2)": results["table_1"],
        "Principles 3 and 4 and Lemma 2: largest load over limit": results["demands"],
        "Random states that meet a lemma": results["lemmas"],
        "The fastest profiles (9) under Principles 1 to 4": [
            _optimum(each) for each in sorted(results["optimal_profiles"], key=lambda each: each.problem.torque_limit)
        ],
        f"Adaptive law: {len(laws[0].runs)} plants, M in {published.M_RANGE} kg, mu in {published.MU_RANGE}": [
            {"law": law.law, "torque_limit": law.torque_limit, "failures": law.failures, "of": name, **run}
            for law in laws
            for name, run in (
                ("the nominal plant", law.runs[len(law.runs) // 2]),
                *((f"the largest {each}", law.worst(each)) for each in ("error_rms", "peak_torque", "mean_speed")),
                ("the smallest mean_speed", law.worst("mean_speed", smallest=True)),
            )
        ],
        f"What the paper leaves open: plants of {len(laws[1].runs)} that fail, unregularised": [
            dict(zip(("beta", "eta(0)", "n", "Hz", "fail"), row, strict=True)) for row in study["variants"]
        ],
        "Long runs of the regularised law: the largest errors of a cycle": [
            {"M": M, "mu": mu, "cycle": cycle, **dict(zip(ERRORS, errors, strict=True))}
            for (M, mu), by_plant in zip(adaptive.LONG_PLANTS, study["long_runs"].transpose(2, 0, 1), strict=True)
            for cycle, errors in zip(adaptive.LONG_CYCLES, by_plant.tolist(), strict=True)
        ],
    }
    return "\n\n".join(f"{title}\n{'=' * len(title)}\n{_section(parts)}" for title, parts in sections.items())


def _section(parts: Sequence[Any]) -> str:
    """Mappings with the same keys as a table, or sentences."""
    if isinstance(parts[0], str):
        return "\n".join(textwrap.fill(f"- {part}", WIDTH) for part in parts)
    head = [name.replace("_", " ") for name in parts[0]]
    return text_table([head, *([_cell(value) for value in row.values()] for row in parts)])


def _verdict(row: Row) -> str:
    return "reproduced" if row["reproduced"] else "NOT reproduced"


def _number(row: Row) -> Row:
    """A published number and ours, with one more digit than printed, so that rounding hides no difference."""
    n = row["number"]
    values = {"published": f"{n.value:.{n.digits}f}", "found": f"{row['found']:.{n.digits + 1}f}"}
    values["difference"] = f"{100.0 * row['difference']:+.1f} %"
    return {"run": row["run"], "quantity": n.quantity, "unit": n.unit, **values, "kind": row["kind"], "": _verdict(row)}


def _optimum(found: Solution) -> Row:
    """The numbers of an optimised profile."""
    row = {name: getattr(found, name) for name in ("cost_of_transport", "peak_torque", "backward_ratio")}
    binding = [name for name, share in found.shares.items() if share >= BINDING]
    speed = printed_below(100.0 * found.mean_speed, 3)
    return {"torque limit, plants, changes": found.problem.label, "cm/s": speed, **row, "binding": binding}
