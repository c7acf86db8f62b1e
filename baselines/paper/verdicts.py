"""Comparison of each published number and claim with the computed one; the page about the paper gives the reasons."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from baselines.laws.adaptive import nominal_estimates
from baselines.laws.gains import UNREGULARISED
from baselines.paper import published
from baselines.paper.adaptive import ERRORS, LONG, LONGEST, cycle_errors
from baselines.paper.published import Number
from capsule_gym.parameters import NOMINAL

Results = dict[str, Any]

# Curves read off a figure, and printed digits, are no more accurate.
AGREEMENT = 0.02
# Travel backwards over forwards that still counts as suppressed.
SUPPRESSED = 0.1
# An error counts as converged once it has fallen to this share of the first cycle's on every plant.
CONVERGED = 0.1
REASONS = {
    "alpha_theta: m l^2": "m l^2 = 0.138 x 0.09 = 0.01242: the digits of the print are transposed.",
    "alpha_theta: m g l": "m g l = 0.40613 with g = 9.81; the print has g = 9.789. The law starts from 0.40613.",
}


def compare_numbers(runs: Results, study: Results) -> list[Results]:
    """Every published number compared with ours: from `reproduce` and `study_adaptive`.

    Returns:
        By row: the `run` that it belongs to, the published `number`, ours in the same unit (`found`), its `kind`
        ("calibrated" where a free parameter was set to meet it, "predicted" where nothing was set, "constant" where it
        restates the plant), the reason for a difference or a note on an agreement (`remark`), the relative
        `difference`, and whether they agree (`reproduced`).
    """
    rows = []

    def add(run: str, number: Number, found: float, kind: str, remark: str = "") -> None:
        row = {"run": run, "number": number, "found": found, "kind": kind, "remark": remark}
        difference = found / number.value - 1.0
        rows.append({**row, "difference": difference, "reproduced": abs(difference) <= AGREEMENT})

    frictions = "; ".join(f"{name} {', '.join(f'{mu:.3f}' for mu in each)}" for name, each in runs["frictions"].items())
    remarks = {
        "mean_speed": "Under exact tracking the speed follows from M, m, l, g and mu alone. The published speeds would "
        f"take mu = {frictions}; the paper states 0.01 for both.",
        "peak_torque": "Impossible at the published rate: see the two proofs.",
    }
    for name, numbers in published.RUNS.items():
        for quantity, number in numbers.items():
            kind = "predicted" if quantity in remarks else "calibrated"
            add(name, number, runs["tracking"][name]["newton"][quantity], kind, remarks.get(quantity, ""))
    proposed, epc = (runs["tracking"][name]["newton"]["swing"] for name in ("proposed", "EPC"))
    add("both", published.SWING_DIFFERENCE, epc - proposed, "calibrated")
    fastest = study["laws"][0].worst("peak_velocity")["peak_velocity"]
    add("adaptive", published.ADAPTIVE_PEAK_VELOCITY, fastest, "calibrated", "printed as 'about'")
    add("plant", published.NATURAL_FREQUENCY, math.sqrt(NOMINAL.g / NOMINAL.l), "constant")
    for number, value in zip(published.BASE_PARAMETERS, nominal_estimates(NOMINAL.plant()), strict=True):
        add("plant", number, value, "constant", REASONS.get(number.quantity, ""))
    return rows


def judge_claims(runs: Results, study: Results) -> list[Results]:
    """Compares every claim of Sect. 5 and Theorem 1 with the results of `reproduce` and `study_adaptive`.

    Returns:
        By row: the key of the `claim` in `published.CLAIMS`, the result (`found`), and whether it holds (`reproduced`).
    """
    proposed, epc = (runs["tracking"][name]["newton"] for name in ("proposed", "EPC"))
    low, high = runs["ratio"]
    regularised, corrected, limited = study["laws"]
    highest = limited.worst("eta")["eta"]
    failures, failures_limited = ([v[column] for v in study["variants"]] for column in (-2, -1))
    failing = (
        f"corrected, unregularised it fails on {corrected.failures} of {len(corrected.runs)} plants, over what the "
        f"paper leaves open on {min(failures)} to {max(failures)}, with a limited motor on {min(failures_limited)} to "
        f"{max(failures_limited)}"
    )
    steepest = max((each for each in regularised.lyapunov if each["M"] != NOMINAL.M), key=lambda each: each["rise"])

    def compared(name: str) -> str:
        return f"{proposed[name]:.3f} against {epc[name]:.3f}"

    def converging(quantity: str, unit: str) -> tuple[str, bool]:
        """Largest errors of a cycle on the corners, and whether all fall to a tenth of the first cycle's."""
        by_cycle = {n: cycle_errors(study, quantity, n)[1:] for n in (1, LONG, LONGEST)}
        ranges = ", ".join(f"{min(each):.1e} to {max(each):.1e} {unit} in cycle {n}" for n, each in by_cycle.items())
        falls = (np.array(by_cycle[LONGEST]) <= CONVERGED * np.array(by_cycle[1])).all()
        return f"regularised, off the nominal plant: {ranges}; it falls and does not vanish", bool(falls)

    angle, rate, sliding = (
        converging(each, unit) for each, unit in zip(ERRORS, ("rad", "rad/s", "rad/s"), strict=True)
    )
    found = {
        "faster": (
            f"{compared('mean_speed')} cm/s; ratio {low:.2f} to {high:.2f} over mu in [0.003, 1]",
            proposed["mean_speed"] > epc["mean_speed"],
        ),
        "torque": (f"{compared('peak_torque')} N m", proposed["peak_torque"] < epc["peak_torque"]),
        "energy": (
            f"cost of transport {compared('cost_of_transport')}, energy per cycle {compared('energy')} J",
            proposed["cost_of_transport"] < epc["cost_of_transport"],
        ),
        "backward": (
            f"{compared('backward')} cm back per cycle, {compared('backward_ratio')} of the way forwards",
            proposed["backward_ratio"] < SUPPRESSED,
        ),
        "adaptive": (
            f"regularised: rms error at most {regularised.worst('error_rms')['error_rms']:.1e} rad; {failing}",
            corrected.failures == 0,
        ),
        "finite_time": angle,
        "rate": rate,
        "sliding": sliding,
        "stable": (f"{failing}. x - x_d grows with every cycle, and T_n with it", max(failures) == 0),
        "bounded": (
            f"corrected, unregularised, with a limited motor eta reaches {highest:.0e}, its numerical bound. Nor is u "
            "continuous: where delta_theta changes sign (39c) jumps by 2 |delta_x| (|eta| + K2)",
            highest < 0.99 * UNREGULARISED.eta_bound,
        ),
        "convergence": (f"{failing}; {angle[0]}", corrected.failures == 0 and angle[1]),
        "lyapunov": (
            f"regularised: it rises in {100.0 * steepest['rising']:.0f} % of the time, by {steepest['rise']:.2f} in "
            f"all (M = {steepest['M']:.2f} kg, mu = {steepest['mu']:.3f})",
            all(each["rise"] == 0.0 for law in (regularised, corrected) for each in law.lyapunov),
        ),
    }
    return [{"claim": claim, "found": text, "reproduced": holds} for claim, (text, holds) in found.items()]
