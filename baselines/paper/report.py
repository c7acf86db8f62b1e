"""The output of `python -m baselines.paper`: tables and remarks as text, and all numbers as plain data."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any

import numpy as np

from baselines.laws.gains import REGULARISED, UNREGULARISED
from baselines.paper import adaptive, principles, proofs, published, selection, tracking
from baselines.paper.adaptive import ERRORS
from baselines.paper.optimal_profiles import load
from baselines.paper.verdicts import AGREEMENT, compare_numbers, judge_claims
from baselines.tables import printed_above, printed_below, text_table
from capsule_gym.task import TORQUE_LIMIT

Results = dict[str, Any]
Row = Mapping[str, Any]

WIDTH = 118
# Share of its limit from which a demand counts as binding; the search keeps a reserve of about one percent.
BINDING = 0.98


def compute() -> Results:
    """Computes all results.

    Returns:
        `numbers` and `claims`: published and found. `runs`: both profiles, tracked exactly and under (35). `adaptive`:
        the law (39). `proof_1`, `proof_2`. `profile_as_printed`: the phases of (9). `table_1`: the result of each
        equation of Sect. 3.2. `boundary_condition`: the requirements of theta(t3) = +theta_0. `demands`: Principles and
        Lemmas on both profiles. `lemmas`: implications of the Lemmas. `optimal_profiles`: the archived searches.
    """
    peaks, rates = proofs.check_proof_1(), proofs.check_proof_2()
    runs = tracking.reproduce()
    study = adaptive.study_adaptive()
    return {
        "numbers": compare_numbers(runs, study),
        "claims": judge_claims(runs, study),
        "runs": runs,
        "adaptive": study,
        "proof_1": peaks,
        "proof_2": rates,
        "profile_as_printed": selection.printed_profile(),
        "table_1": selection.evaluate_selection(),
        "boundary_condition": selection.boundary_condition(),
        "demands": principles.evaluate_demands(),
        "lemmas": principles.check_lemmas(),
        "optimal_profiles": load(),
    }


def plain(value: Any) -> Any:
    """A value as nested dicts, lists and numbers, for JSON."""
    value = vars(value) if is_dataclass(value) else value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _cell(value: Any) -> str:
    """A value as text, numbers with four digits."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_cell, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _table(rows: Sequence[Row]) -> str:
    """Mappings with the same keys as a table; the header has the keys."""
    head = [name.replace("_", " ") for name in rows[0]]
    return text_table([head, *([_cell(value) for value in row.values()] for row in rows)])


def _picked(rows: Sequence[Row], *without: str) -> list[Row]:
    """The rows without some of their entries."""
    return [{name: value for name, value in row.items() if name not in without} for row in rows]


def text(results: Results) -> str:
    """All tables and remarks, for a terminal."""
    runs, study = results["runs"], results["adaptive"]
    nominal = len(study["laws"][0].runs) // 2
    ranges = (f"M in {[*published.M_RANGE]} kg", f"mu in {[*published.MU_RANGE]}")
    sections: dict[str, list[str | Sequence[Row]]] = {
        "Section 5 of the paper: published and found": [
            *_numbers(results["numbers"]),
            "'calibrated': a free parameter of the profile (V1, P2) was set to meet it; 'predicted': nothing was set; "
            f"'constant': restates the plant. Reproduced means within {100.0 * AGREEMENT:.0f} %. Five cycles from "
            "rest, mu = 0.01, Newton's normal force, feedback linearisation (35) at 1 kHz.",
        ],
        "What the paper claims": [
            f"- {claim} ({where}): {'reproduced' if row['reproduced'] else 'NOT reproduced'}. Found: {row['found']}."
            for row in results["claims"]
            for claim, where in [published.CLAIMS[row["claim"]]]
        ],
        "Both profiles under feedback linearisation (35)": [
            [
                {"profile": profile, "normal_force": force, **run}
                for profile, forces in runs["tracking"].items()
                for force, run in forces.items()
            ],
            "rad/s, degrees, cm/s, N m, J a cycle, cm a cycle; error: rms of theta - theta_d, rad.",
        ],
        "Why the published torques are impossible: two proofs": [
            "Proof 1, at the peak: where theta' peaks the motor gives at least 'bound' N m, for every angle of the "
            "published swing, in stick and either direction of slip, and for either normal force.",
            [_rounded(row, below=("bound", "sticking")) for row in results["proof_1"]],
            "Proof 2, in the phase plane: with |u| <= 'torque' theta' stays below 'bound' rad/s from rest anywhere in "
            "the swing. Torques needed, and enough, for the published rate from -60 degrees.",
            [
                _rounded(row, below=("torque_needed",), above=("bound", "from_start", "torque_enough", "undamped"))
                for row in results["proof_2"]
            ],
            "Lower bounds are rounded down, upper bounds up. The mean speeds are not affected.",
        ],
        "Sensitivity": _sensitivity(runs),
        "The profile (9) as printed, and as built": [
            results["profile_as_printed"],
            "Rates at start and end, rad/s, and angle, rad; omega = pi / (2 t1). As printed it turns the pendulum by "
            f"{math.degrees(sum(row['printed'][2] for row in results['profile_as_printed'])):.0f} degrees a cycle.",
        ],
        "What Table 1 follows from (Sect. 3.2)": [
            _picked(results["table_1"], "rounding"),
            "Follows: the two agree within the digits of Table 1, all its times varied by half a last digit. The "
            "condition theta(t3) = +theta_0, on which (23), (30) and (31) rest, has another solution (rad, rad/s); "
            "at the published rate, the angle reached at t3 and the drift of every cycle with the P3 of (23):",
            [results["boundary_condition"]],
        ],
        "Principles 1 to 4 and Lemmas 1 and 2: largest load over limit (above 1: violated)": [
            results["demands"],
            "Nominal plant; before the restoring stage, and in each of its phases. Principle 4 and Lemma 2 apply to "
            "the restoring stage only. Random states that meet a lemma, and violations of its principle among them:",
            results["lemmas"],
        ],
        "The optimum of the paper's own family of profiles, exact tracking, Principles 1 to 4": [
            [
                {
                    "torque limit, plants, changes": each.problem.label,
                    "cm/s": printed_below(100.0 * each.mean_speed, 3),
                    "cost of transport": each.cost_of_transport,
                    "N m": each.peak_torque,
                    "backward": each.backward_ratio,
                    "binding": [name for name, share in each.shares.items() if share >= BINDING],
                }
                for each in sorted(results["optimal_profiles"], key=lambda each: each.problem.torque_limit)
            ],
            "Of the worst plant. The speeds are lower bounds of the optimum, rounded down.",
        ],
        f"Adaptive law (39), {len(study['laws'][0].runs)} plants: {', '.join(ranges)}": [
            [
                {"law": law.law, "torque_limit": law.torque_limit, "failures": law.failures, "of": name, **run}
                for law in study["laws"]
                for name, run in [
                    ("the nominal plant", law.runs[nominal]),
                    ("the largest error", law.worst("error_rms")),
                    ("the largest torque", law.worst("peak_torque")),
                    ("the slowest", law.worst("mean_speed", smallest=True)),
                    ("the fastest", law.worst("mean_speed")),
                ]
            ],
            f"Corrected, unregularised: {UNREGULARISED._asdict()}. Regularised: {REGULARISED._asdict()}.",
        ],
        f"What the paper leaves open: plants of {len(study['laws'][1].runs)} that fail, law corrected, unregularised": [
            [
                dict(zip(("beta", "eta(0)", "n", "Hz", "fail", f"fail at {TORQUE_LIMIT:g} N m"), row, strict=True))
                for row in study["variants"]
            ]
        ],
        "Long runs of the regularised law: the largest errors of a cycle": [
            [
                {"Hz": rate, "M": M, "mu": mu, "cycle": cycle, **dict(zip(ERRORS, run[cycle], strict=True))}
                for rate, long_runs in study["long_runs"].items()
                for (M, mu), run in zip((adaptive.NOMINAL_PLANT, *adaptive.CORNERS), long_runs, strict=True)
                for cycle in run
            ]
        ],
        "The Lyapunov function V of (40) along the run, with the true plant's parameters": [
            [{"law": law.law, **values} for law in study["laws"][:2] for values in law.lyapunov]
        ],
    }
    return "\n\n".join(
        f"{title}\n{'=' * len(title)}\n"
        + "\n\n".join(textwrap.fill(part, WIDTH) if isinstance(part, str) else _table(part) for part in parts)
        for title, parts in sections.items()
    )


def _numbers(rows: Sequence[Row]) -> list[Any]:
    """The table of published and found numbers, and its remarks."""
    cells, remarks = [], []
    for row in rows:
        number, verdict = row["number"], "reproduced" if row["reproduced"] else "NOT reproduced"
        if row["remark"]:
            remarks.append(f"[{len(remarks) + 1}] {row['remark']}")
            verdict += f" [{len(remarks)}]"
        cells.append(
            {
                "run": row["run"],
                "quantity": number.quantity,
                "unit": number.unit,
                # One more digit than printed, so that rounding hides no difference.
                "published": f"{number.value:.{number.digits}f}",
                "found": f"{row['found']:.{number.digits + 1}f}",
                "difference": f"{100.0 * row['difference']:+.1f} %",
                "kind": row["kind"],
                "verdict": verdict,
            }
        )
    return [cells, *remarks]


def _rounded(row: Row, below: Sequence[str] = (), above: Sequence[str] = ()) -> Row:
    """A row with its lower bounds rounded down and its upper bounds rounded up."""
    rounded = {**{name: printed_below for name in below}, **{name: printed_above for name in above}}
    return {name: rounded[name](value, 3) if name in rounded else value for name, value in row.items()}


def _sensitivity(runs: Results) -> list[Any]:
    """Other plants and steps."""
    ratio = tracking.speed_ratio(*runs["maps"])
    steps = [
        {
            "step (s)": step,
            **{
                f"{name}, {unit}": float(column[n])
                for name, columns in runs["steps"].items()
                for unit, column in zip(("cm/s", "N m"), columns, strict=True)
            },
        }
        for n, step in enumerate(tracking.STEPS)
    ]
    return [
        f"Over M in {tracking.M_RANGE} kg, mu in {tracking.MU_RANGE}: proposed / EPC {np.nanmin(ratio):.3f} to "
        f"{np.nanmax(ratio):.3f}. EPC loses contact below M = {runs['maps'][1].least_mass_in_contact:.3f} kg.",
        steps,
        "Law and physics at the same step; the law runs at 1 kHz everywhere else.",
    ]
