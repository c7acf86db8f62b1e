"""The output of `python -m baselines.paper`: tables of all results, and a verdict on every claim.

The page *The paper* explains the results and gives the reasons.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np

from baselines.paper import principles, published, selection, tracking
from baselines.paper.adaptive import (
    ERRORS,
    LONG_CYCLES,
    LONG_PLANTS,
    LawStudy,
    run_cycles,
    study_law,
    study_variants,
)
from baselines.paper.optimal_profiles import Solution, load
from baselines.paper.published import Number
from baselines.paper.tracking import speed_ratio
from baselines.tables import fields_table, printed_below
from capsule_gym.control.laws.adaptive import adaptive, nominal_estimates
from capsule_gym.control.laws.gains import UNREGULARISED
from capsule_gym.parameters import NOMINAL, NormalForce
from capsule_gym.tasks.task import TORQUE_LIMIT

Results = dict[str, Any]
Row = dict[str, Any]
Claims = dict[str, tuple[str, bool]]

WIDTH = 118  # columns of a sentence
# Share of its limit from which a demand counts as binding; the search keeps a reserve of about one
# percent.
BINDING = 0.98
AGREEMENT = 0.02  # curves read off a figure, and printed digits, are no more accurate
SUPPRESSED = 0.1  # travel backwards over forwards that still counts as suppressed
# An error has converged once it is at most this share of the first cycle's on every plant.
CONVERGED = 0.1
# Share of its numerical bound from which eta counts as unbounded.
UNBOUNDED = 0.99
# Quantities of a run that no free parameter was set to meet.
PREDICTED = ("mean_speed", "peak_torque")


def compute() -> Results:
    """Computes all results, each by the function that describes it.

    The results of both profiles are by profile and normal force, those of the adaptive law for the
    regularised law, the corrected, unregularised one, and the latter with the motor's torque
    limited.
    """
    results: Results = {"tracking": _track_profiles()}
    grid = tracking.grid()
    results["maps"] = [tracking.speed_map(profile, *grid) for profile in tracking.PROFILES]
    results["laws"] = [study_law(True), study_law(False), study_law(False, TORQUE_LIMIT)]
    results["variants"] = study_variants()
    cycles = LONG_CYCLES[-1]
    _, results["long_runs"] = run_cycles(adaptive(), LONG_PLANTS, cycles, LONG_CYCLES)
    results["numbers"] = compare_numbers(results)
    results["claims"] = judge_claims(results)
    results["torques"] = principles.check_torques()
    results["table_1"] = selection.evaluate_selection()
    results["demands"] = principles.evaluate_demands()
    results["lemmas"] = principles.check_lemmas()
    results["optimal_profiles"] = load()
    return results


def _track_profiles() -> dict[str, dict[str, dict[str, float]]]:
    """The runs of both profiles under (35), by the name of the profile and the normal force."""
    forces = get_args(NormalForce)
    tracked = {}
    for profile in tracking.PROFILES:
        tracked[profile.name] = {force: tracking.track(profile, force) for force in forces}
    return tracked


def compare_numbers(results: Results) -> list[Row]:
    """Compares every published number with ours.

    The kind of a number is "calibrated" where a free parameter was set to meet it, "predicted"
    where nothing was set, and "constant" where it restates the plant.
    """
    rows = []
    swings = []
    for run, numbers in published.RUNS.items():
        tracked = results["tracking"][run]["newton"]
        swings.append(tracked["swing"])
        for quantity, number in numbers.items():
            kind = "predicted" if quantity in PREDICTED else "calibrated"
            rows.append(_compare(run, number, tracked[quantity], kind))

    proposed, epc = swings
    rows.append(_compare("both", published.SWING_DIFFERENCE, epc - proposed, "calibrated"))
    fastest = results["laws"][0].worst("peak_velocity")
    peak = published.ADAPTIVE_PEAK_VELOCITY
    rows.append(_compare("adaptive", peak, fastest["peak_velocity"], "calibrated"))

    frequency = math.sqrt(NOMINAL.g / NOMINAL.l)
    rows.append(_compare("plant", published.NATURAL_FREQUENCY, frequency, "constant"))
    estimates = nominal_estimates(NOMINAL.plant())
    for number, value in zip(published.BASE_PARAMETERS, estimates, strict=True):
        rows.append(_compare("plant", number, value, "constant"))
    return rows


def _compare(run: str, number: Number, found: float, kind: str) -> Row:
    """A row of `compare_numbers`."""
    printed = f"{number.value:.{number.digits}f}"
    # One more digit than printed, so that rounding hides no difference.
    own = f"{found:.{number.digits + 1}f}"
    difference = found / number.value - 1.0
    return {
        "run": run,
        "quantity": number.quantity,
        "unit": number.unit,
        "published": printed,
        "found": own,
        "difference": f"{100.0 * difference:+.1f} %",
        "kind": kind,
        "": _verdict(abs(difference) <= AGREEMENT),
    }


def _verdict(holds: bool) -> str:
    return "reproduced" if holds else "NOT reproduced"


def judge_claims(results: Results) -> Claims:
    """By claim of Sect. 5 and Theorem 1 the result, and whether the claim holds."""
    return _judge_profiles(results) | _judge_adaptive_law(results)


def _judge_profiles(results: Results) -> Claims:
    """The claims about the proposed profile and EPC."""
    proposed, epc = (results["tracking"][name]["newton"] for name in published.RUNS)

    def compared(name: str) -> str:
        return f"{proposed[name]:.3f} against {epc[name]:.3f}"

    def lower(name: str) -> bool:
        return bool(proposed[name] < epc[name])

    ratio = float(np.nanmax(speed_ratio(*results["maps"])))
    speeds = f"{compared('mean_speed')} cm/s, at most {ratio:.3f} of EPC's speed over M and mu"
    faster = proposed["mean_speed"] > epc["mean_speed"]
    torques = f"{compared('peak_torque')} N m"
    costs = f"cost of transport {compared('cost_of_transport')}"
    energies = f"energy per cycle {compared('energy')} J"
    distances = f"{compared('backward')} cm back per cycle"
    ratios = f"{compared('backward_ratio')} of the way forwards"
    suppressed = proposed["backward_ratio"] < SUPPRESSED
    return {
        "the proposed profile is faster than EPC (Sect. 5)": (speeds, faster),
        "its largest torque is lower than EPC's (Sect. 5)": (torques, lower("peak_torque")),
        "its energy efficacy is superior (Sect. 5)": (
            f"{costs}, {energies}",
            lower("cost_of_transport"),
        ),
        "backward motions are sufficiently suppressed (Fig. 4)": (
            f"{distances}, {ratios}",
            suppressed,
        ),
    }


def _judge_adaptive_law(results: Results) -> Claims:
    """The claims about the adaptive law: tracking, and Theorem 1."""
    regularised, corrected, limited = results["laws"]
    variants = [failures for *_, failures in results["variants"]]
    never_fails = corrected.failures == 0
    always_stable = max(variants) == 0
    failing = (
        f"corrected, unregularised it fails on {corrected.failures} of {len(corrected.runs)} plants"
        f", over what the paper leaves open on {min(variants)} to {max(variants)}"
    )
    error = regularised.worst("error_rms")["error_rms"]
    tracking_error = f"regularised: rms error at most {error:.1e} rad"

    eta = limited.worst("eta")["eta"]
    bounded = eta < UNBOUNDED * UNREGULARISED.eta_bound
    signals = (
        f"corrected, unregularised, with a limited motor eta reaches {eta:.0e}, its numerical bound"
    )

    convergence, converged = _judge_convergence(results["long_runs"])
    steepest = regularised.worst("rise")
    where = f"M = {steepest['M']:.2f} kg, mu = {steepest['mu']:.3f}"
    rising = (
        f"regularised: it rises in {100.0 * steepest['rising']:.0f} % of the time, "
        f"by {steepest['rise']:.2f} in all ({where})"
    )
    never_rises = all(run["rise"] == 0.0 for run in regularised.runs + corrected.runs)
    claims: Claims = {}
    claims["the adaptive law tracks exactly for every M and mu of the ranges (Sect. 5)"] = (
        f"{tracking_error}; {failing}",
        never_fails,
    )
    claims["the system is globally asymptotically stabilized (Theorem 1 (1))"] = (
        failing,
        always_stable,
    )
    claims[
        "all signals in the closed loop are bounded and uniformly continuous (Theorem 1 (2))"
    ] = (signals, bounded)
    claims[
        "the collocated errors converge to zero (Theorem 1 (3), Figs. 7 and 9), in finite time "
        "(Abstract)"
    ] = (f"{failing}; {convergence}", converged and never_fails)
    claims["the Lyapunov function (40) never rises (Theorem 1, Eq. (41))"] = (rising, never_rises)
    return claims


def _judge_convergence(long_runs: np.ndarray) -> tuple[str, bool]:
    """The errors of the angle, and whether all errors converge."""
    errors = long_runs[..., 1:]  # without the nominal plant
    angle_errors = errors[:, ERRORS.index("angle_error")]
    ranges = ", ".join(f"{own.min():.1e} to {own.max():.1e}" for own in angle_errors)
    found = (
        f"regularised, off the nominal plant the angle's largest error in the cycles {LONG_CYCLES} "
        f"is {ranges} rad"
    )
    return found, bool((errors[-1] <= CONVERGED * errors[0]).all())


def text(results: Results) -> str:
    """Formats all tables for a terminal.

    Quantities without a unit are in rad, rad/s, N m, J and cm a cycle, and cm/s.
    """
    laws = results["laws"]
    plants = len(laws[0].runs)
    maps = f"M in {tracking.M_RANGE} kg, mu in {tracking.MU_RANGE}"
    ranges = f"M in {published.M_RANGE} kg, mu in {published.MU_RANGE}"
    sections = {
        "Section 5 of the paper: published and found": results["numbers"],
        "What the paper claims": _sentences(results["claims"]),
        "Both profiles under feedback linearisation (35)": _tracking_rows(results["tracking"]),
        "Proof: torque where theta' peaks": _torque_rows(results["torques"]),
        f"Sensitivity: speeds over {maps}": _sensitivity_rows(results["maps"]),
        "What Table 1 follows from (Sect. 3.2)": results["table_1"],
        "Principles 3 and 4 and Lemma 2: largest load over limit": results["demands"],
        "Random states that meet a lemma": results["lemmas"],
    }
    optima = sorted(results["optimal_profiles"], key=lambda each: each.problem.torque_limit)
    sections |= {
        "The fastest profiles (9) under Principles 1 to 4": [optimum_row(each) for each in optima],
        f"Adaptive law: {plants} plants, {ranges}": _law_rows(laws),
        f"What the paper leaves open: plants of {plants} that fail, unregularised": [
            dict(zip(("beta", "eta(0)", "n", "Hz", "fail"), variant, strict=True))
            for variant in results["variants"]
        ],
        "Long runs of the regularised law: the largest errors of a cycle": _long_run_rows(
            results["long_runs"]
        ),
    }
    return "\n\n".join(_section(title, content) for title, content in sections.items())


def _section(title: str, content: list[Row] | str) -> str:
    table = content if isinstance(content, str) else fields_table(content)
    return f"{title}\n{'=' * len(title)}\n{table}"


def _sentences(claims: Claims) -> str:
    """A sentence for each claim with its verdict and what was found."""
    lines = []
    for claim, (found, holds) in claims.items():
        sentence = f"- {claim}: {_verdict(holds)}. Found: {found}."
        lines.append(textwrap.fill(sentence, WIDTH))
    return "\n".join(lines)


def _tracking_rows(tracked: Mapping[str, Mapping[str, Row]]) -> list[Row]:
    rows: list[Row] = []
    for name, by_force in tracked.items():
        rows += [{"profile": name, "N by": force, **run} for force, run in by_force.items()]
    return rows


def _torque_rows(torques: Sequence[Row]) -> list[Row]:
    """The rows with bounds rounded down, so that the printed numbers are bounds as well."""
    rows = []
    for row in torques:
        rounded = {name: printed_below(row[name], 3) for name in ("bound", "sticking")}
        rows.append({**row, **rounded})
    return rows


def _sensitivity_rows(maps: Sequence[np.ndarray]) -> list[Row]:
    frictions = []
    for profile in tracking.PROFILES:
        speed = published.RUNS[profile.name]["mean_speed"].value
        frictions.append(tracking.friction_for(profile, speed))
    ratio = speed_ratio(*maps)
    row = {
        "mu for the published speed": frictions,
        "proposed over EPC, least": float(np.nanmin(ratio)),
        "most": float(np.nanmax(ratio)),
    }
    return [row]


def optimum_row(solution: Solution) -> Row:
    """The numbers of an optimised profile, and the demands that limit it."""
    shares = solution.shares.items()
    return {
        "torque limit, plants, changes": solution.problem.label,
        "cm/s": printed_below(100.0 * solution.mean_speed, 3),
        "cost_of_transport": solution.cost_of_transport,
        "peak_torque": solution.peak_torque,
        "backward_ratio": solution.backward_ratio,
        "binding": [name for name, share in shares if share >= BINDING],
    }


def _law_rows(laws: Sequence[LawStudy]) -> list[Row]:
    """Of each form of the law the run on the nominal plant, and those with extreme numbers."""
    rows: list[Row] = []
    for law in laws:
        shown = {"the nominal plant": law.runs[len(law.runs) // 2]}
        for quantity in ("error_rms", "peak_torque", "mean_speed"):
            shown[f"the largest {quantity}"] = law.worst(quantity)
        shown["the smallest mean_speed"] = law.worst("mean_speed", smallest=True)
        form = {"law": law.law, "torque_limit": law.torque_limit, "failures": law.failures}
        rows += [{**form, "of": name, **run} for name, run in shown.items()]
    return rows


def _long_run_rows(long_runs: np.ndarray) -> list[Row]:
    rows = []
    for (M, mu), by_cycle in zip(LONG_PLANTS, long_runs.transpose(2, 0, 1), strict=True):
        for cycle, largest in zip(LONG_CYCLES, by_cycle.tolist(), strict=True):
            errors = dict(zip(ERRORS, largest, strict=True))
            rows.append({"M": M, "mu": mu, "cycle": cycle, **errors})
    return rows
