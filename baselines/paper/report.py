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
from baselines.paper.optimal_profiles import Solution, load
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


def text(results: Results) -> str:
    """All tables and remarks, for a terminal."""
    runs, study, profiles = results["runs"], results["adaptive"], results["optimal_profiles"]
    laws, nominal, ratio = study["laws"], len(study["laws"][0].runs) // 2, tracking.speed_ratio(*runs["maps"])
    failing = ("beta", "eta(0)", "n", "Hz", "fail", f"fail at {TORQUE_LIMIT:g} N m")
    ranges = f"M in {[*published.M_RANGE]} kg, mu in {[*published.MU_RANGE]}"
    turned = math.degrees(sum(phase["printed"][2] for phase in results["profile_as_printed"]))
    sections: dict[str, list[str | list[Row]]] = {
        "Section 5 of the paper: published and found": [
            [_number(row) for row in results["numbers"]],
            *dict.fromkeys(f"{row['number'].quantity}: {row['remark']}" for row in results["numbers"] if row["remark"]),
            "'calibrated': a free parameter of the profile (V1, P2) was set to meet it; 'predicted': nothing was set; "
            f"'constant': restates the plant. Reproduced means within {100.0 * AGREEMENT:.0f} %. Five cycles from "
            "rest, mu = 0.01, Newton's normal force, feedback linearisation (35) at 1 kHz.",
        ],
        "What the paper claims": [
            "- {} ({}): {}. Found: {}.".format(
                *published.CLAIMS[row["claim"]],
                "reproduced" if row["reproduced"] else "NOT reproduced",
                row["found"],
            )
            for row in results["claims"]
        ],
        "Both profiles under feedback linearisation (35)": [
            [
                {"profile": p, "N by": force, **run}
                for p, forces in runs["tracking"].items()
                for force, run in forces.items()
            ],
            "rad/s, degrees, cm/s, N m, J a cycle, cm a cycle; error: rms of theta - theta_d, rad.",
        ],
        "Why the published torques are impossible: two proofs": [
            "Proof 1: where theta' peaks, the motor gives at least 'bound' N m for every angle of the published swing.",
            [_rounded(row, "bound", "sticking") for row in results["proof_1"]],
            "Proof 2: with |u| <= 'torque' theta' stays below 'bound' rad/s from rest anywhere in the swing. 'torque "
            "needed', 'torque enough' (by simulation): for the published rate from -60 degrees.",
            [_rounded(row, "torque_needed") for row in results["proof_2"]],
            "Lower bounds are rounded down, upper bounds up. The mean speeds are not affected.",
        ],
        "Sensitivity": [
            f"Over M in {tracking.M_RANGE} kg, mu in {tracking.MU_RANGE}: proposed / EPC {np.nanmin(ratio):.3f} to "
            f"{np.nanmax(ratio):.3f}. EPC loses contact below M = {runs['maps'][1].least_mass_in_contact:.3f} kg.",
            [
                {"profile": name, "step of law and physics (s)": step, "cm/s": float(speed), "N m": float(torque)}
                for name, found in runs["steps"].items()
                for step, speed, torque in zip(tracking.STEPS, *found, strict=True)
            ],
        ],
        "The profile (9) as printed, and as built": [
            results["profile_as_printed"],
            "Rates at start and end, rad/s, and angle, rad; omega = pi / (2 t1). As printed it turns the pendulum by "
            f"{turned:.0f} degrees a cycle.",
        ],
        "What Table 1 follows from (Sect. 3.2)": [
            results["table_1"],
            "Follows: the two agree within the digits of Table 1, all its times varied by half a last digit. The "
            "condition theta(t3) = +theta_0, on which (23), (30) and (31) rest, has another solution (rad/s, rad); "
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
            [_optimum(each) for each in sorted(profiles, key=lambda each: each.problem.torque_limit)],
            "Of the worst plant. The speeds are lower bounds of the optimum, rounded down.",
        ],
        f"Adaptive law (39), {len(laws[0].runs)} plants: {ranges}": [
            [
                {"law": law.law, "torque_limit": law.torque_limit, "failures": law.failures, "of": name, **run}
                for law in laws
                for name, run in (
                    ("the nominal plant", law.runs[nominal]),
                    *((f"the largest {each}", law.worst(each)) for each in ("error_rms", "peak_torque", "mean_speed")),
                    ("the smallest mean_speed", law.worst("mean_speed", smallest=True)),
                )
            ],
            f"Corrected, unregularised: {UNREGULARISED._asdict()}. Regularised: {REGULARISED._asdict()}.",
        ],
        f"What the paper leaves open: plants of {len(laws[1].runs)} that fail, law corrected, unregularised": [
            [dict(zip(failing, row, strict=True)) for row in study["variants"]]
        ],
        "Long runs of the regularised law: the largest errors of a cycle": [
            [
                {"Hz": rate, "M": M, "mu": mu, "cycle": cycle, **dict(zip(ERRORS, errors, strict=True))}
                for rate, by_plant in study["long_runs"].items()
                for (M, mu), cycles in zip((adaptive.NOMINAL_PLANT, *adaptive.CORNERS), by_plant, strict=True)
                for cycle, errors in cycles.items()
            ]
        ],
        "The Lyapunov function V of (40) along the run, with the true plant's parameters": [
            [{"law": law.law, **values} for law in laws[:2] for values in law.lyapunov]
        ],
    }
    return "\n\n".join(
        f"{title}\n{'=' * len(title)}\n"
        + "\n\n".join(textwrap.fill(part, WIDTH) if isinstance(part, str) else _table(part) for part in parts)
        for title, parts in sections.items()
    )


def _number(row: Row) -> Row:
    """A published number and ours, with one more digit than printed, so that rounding hides no difference."""
    n, verdict = row["number"], "reproduced" if row["reproduced"] else "NOT reproduced"
    values = {"published": f"{n.value:.{n.digits}f}", "found": f"{row['found']:.{n.digits + 1}f}"}
    values["difference"] = f"{100.0 * row['difference']:+.1f} %"
    return {"run": row["run"], "quantity": n.quantity, "unit": n.unit, **values, "kind": row["kind"], "": verdict}


def _optimum(found: Solution) -> Row:
    """The numbers of an optimised profile."""
    row = {name: getattr(found, name) for name in ("cost_of_transport", "peak_torque", "backward_ratio")}
    binding = [name for name, share in found.shares.items() if share >= BINDING]
    speed = printed_below(100.0 * found.mean_speed, 3)
    return {"torque limit, plants, changes": found.problem.label, "cm/s": speed, **row, "binding": binding}


def _rounded(row: Row, *lower: str) -> Row:
    """A row of a proof with its lower bounds rounded down and its other bounds rounded up."""
    upper = {"bound", "from_start", "torque_enough", "undamped"} - {*lower}
    rounded = {name: printed_below(row[name], 3) for name in lower}
    rounded |= {name: printed_above(row[name], 3) for name in upper if name in row}
    return {**row, **rounded}
