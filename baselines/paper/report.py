"""The output of `python -m baselines.paper`: tables and remarks as text, and all numbers as plain data."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

import numpy as np

from baselines.laws.gains import REGULARISED, UNREGULARISED
from baselines.laws.profiles import V1
from baselines.paper import adaptive, principles, proofs, published, selection, tracking
from baselines.paper.adaptive import ERRORS, LONG, RATES, cycle_errors
from baselines.paper.optimal_profiles import load
from baselines.paper.principles import RESTORING_PHASES, THETA_0
from baselines.paper.verdicts import AGREEMENT, compare_numbers, judge_claims
from baselines.tables import printed_above, printed_below, text_table
from capsule_gym.task import TORQUE_LIMIT

WIDTH = 118
# Share of its limit from which a demand counts as binding; the search keeps a reserve of about one percent.
BINDING = 0.98

Cells = list[list[str]]
Results = dict[str, Any]


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
        "numbers": compare_numbers(runs, study, peaks, rates),
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


def text(results: Results) -> str:
    """All tables and remarks, for a terminal."""
    sections = [numbers_text, claims_text, tracking_text, proofs_text, sensitivity_text, profile_text, table_1_text]
    sections += [principles_text, optimal_profiles_text, ranges_text, choices_text, long_runs_text, lyapunov_text]
    return "\n\n".join(section(results) for section in sections)


def _section(title: str, *parts: str | Cells, left: int = 1, last_left: bool = False) -> str:
    """A heading with paragraphs (texts) and tables (cells, of which the first row is the header)."""
    blocks = []
    for part in parts:
        text = isinstance(part, str)
        blocks.append(textwrap.fill(str(part), WIDTH) if text else text_table(part, left=left, last_left=last_left))
    return f"{title}\n{'=' * len(title)}\n" + "\n\n".join(blocks)


def _formatted(values: Mapping[str, Any], styles: Mapping[str, str]) -> list[str]:
    """Some of the values, each in its style."""
    return [format(values[name], style) for name, style in styles.items()]


def numbers_text(results: Results) -> str:
    """Published numbers and ours."""
    cells = [["run", "quantity", "unit", "published", "found", "difference", "kind", "verdict"]]
    remarks: list[str] = []
    for row in results["numbers"]:
        number, verdict = row["number"], "reproduced" if row["reproduced"] else "NOT reproduced"
        if row["remark"]:
            remarks.append(f"[{len(remarks) + 1}] {row['remark']}")
            verdict += f" [{len(remarks)}]"
        # One more digit than printed, so that rounding hides no difference.
        values = f"{number.value:.{number.digits}f}", f"{row['found']:.{number.digits + 1}f}"
        difference = f"{100.0 * row['difference']:+.1f} %".replace("-0.0", "+0.0")
        cells.append([row["run"], number.quantity, number.unit, *values, difference, row["kind"], verdict])
    explanation = (
        "'calibrated': a free parameter of the profile (V1, P2) was set to meet it; 'predicted': nothing was set; "
        f"'constant': restates the plant. Reproduced means within {100.0 * AGREEMENT:.0f} %. Five cycles from rest, mu "
        "= 0.01, Newton's normal force, feedback linearisation (35) at 1 kHz. The published numbers are those of the "
        "paper's text: its curves are not available as data."
    )
    title = "Section 5 of the paper: published and found"
    return _section(title, cells, explanation, *remarks, left=3, last_left=True)


def claims_text(results: Results) -> str:
    """Claims without a number of their own."""
    lines = []
    for row in results["claims"]:
        (claim, where), word = published.CLAIMS[row["claim"]], "reproduced" if row["reproduced"] else "NOT reproduced"
        lines.append(f"- {claim} ({where}): {word}. Found: {row['found']}.")
    return _section("What the paper claims", *lines)


def tracking_text(results: Results) -> str:
    """Both profiles under (35), with both options for the normal force."""
    head = ["profile", "normal force", "theta'\nrad/s", "swing\ndeg", "speed\ncm/s", "torque\nN m", "energy\nJ/cycle"]
    styles = {"peak_velocity": ".3f", "swing": ".2f", "mean_speed": ".4f", "peak_torque": ".4f", "energy": ".3f"}
    styles |= {"cost_of_transport": ".3f", "backward": ".3f", "error": ".1e"}
    cells = [[*head, "cost of\ntransport", "back\ncm/cycle", "rms error\nrad"]]
    for profile, runs in results["runs"]["tracking"].items():
        cells += [[profile, force, *_formatted(run, styles)] for force, run in runs.items()]
    return _section("Both profiles under feedback linearisation (35)", cells, left=2)


def proofs_text(results: Results) -> str:
    """Both proofs; every bound is rounded conservatively."""
    first = [["profile", "theta'", "published", "at least", "sticking", "at", "with"]]
    for row in results["proof_1"]:
        bounds = [printed_below(row[name], 4) for name in ("bound", "sticking")]
        stated = [f"{row['velocity']:g} rad/s", f"{row['published']:.4f} N m"]
        first.append([row["name"], *stated, *bounds, f"{math.degrees(row['angle']):.1f} deg", row["mode"]])
    head = ["profile", "limit", "published", "theta' below", "from -60 deg"]
    second = [[*head, "needed at least", "enough", "if c = 0"]]
    for row in results["proof_2"]:
        stated = [f"{row['torque']:.4f} N m", f"{row['published']:g} rad/s"]
        bounds = [printed_above(row["bound"], 3) + " rad/s", printed_above(row["from_start"], 3)]
        bounds += [printed_below(row["torque_needed"], 3) + " N m", printed_above(row["torque_enough"], 3) + " N m"]
        second.append([row["name"], *stated, *bounds, printed_above(row["undamped"], 2) + " rad/s"])
    holds = all(row["holds"] for row in (*results["proof_1"], *results["proof_2"]))
    return _section(
        "Why the published torques are impossible: two proofs",
        "Proof 1, at the peak. Where theta' peaks theta'' = 0. The motor then gives at least this torque, for every "
        "angle of the published swing, in stick and either direction of slip, and for either normal force.",
        first,
        "Proof 2, in the phase plane. No motion with |u| within the limit crosses the upper envelope, whatever the "
        "reference, the law or the gains. 'theta' below': from rest anywhere within +-swing. 'needed': no torque "
        "within it takes the pendulum from rest at -60 degrees to the published velocity; 'enough': a constant torque "
        "that does, by simulation. 'if c = 0': the envelope from -60 degrees without the damper.",
        second,
        f"All four hold: {'yes' if holds else 'NO'}. The published torques and velocities exclude each other on the "
        "published plant; the mean speeds are not affected. Lower bounds are rounded down, upper bounds up.",
    )


def sensitivity_text(results: Results) -> str:
    """Other plants and steps."""
    maps, M, mu = results["runs"]["maps"], tracking.M_RANGE, tracking.MU_RANGE
    ratio = tracking.speed_ratio(*maps)
    note = (
        f"Over M = {M[0]:g} to {M[1]:g} kg, mu = {mu[0]:g} to {mu[1]:g}: proposed / EPC {np.nanmin(ratio):.3f} to "
        f"{np.nanmax(ratio):.3f}. EPC loses contact below M = {maps[1].least_mass_in_contact:.3f} kg."
    )
    cells = [["step, ms", "proposed\ncm/s", "\nN m", "EPC\ncm/s", "\nN m"]]
    for n, step in enumerate(tracking.STEPS):
        values = (f"{column[n]:.5f}" for study in results["runs"]["steps"].values() for column in study)
        cells.append([f"{1e3 * step:g}", *values])
    last = "Law and physics at the same step; the law runs at 1 kHz everywhere else."
    return _section("Sensitivity", note, cells, last)


def profile_text(results: Results) -> str:
    """The profile (9) as printed."""
    cells = [["phase", "as printed", "begins", "ends", "turns, deg", "built: begins", "ends", "turns, deg", ""]]
    total = 0.0
    for phase in results["profile_as_printed"]:
        values = [v for a, b, angle in (phase["printed"], phase["built"]) for v in (a, b, math.degrees(angle))]
        total += values[2]
        # Adding 0.0 turns -0.0 into 0.0.
        numbers = [f"{value + 0.0:.3f}" for value in values]
        cells.append([phase["name"], phase["formula"], *numbers, "deviates" if phase["deviates"] else ""])
    turns = f"omega = pi / (2 t1). As printed it turns the pendulum by {total:.0f} degrees a cycle."
    return _section("The profile (9) as printed, and as built (rad/s)", cells, turns, left=2, last_left=True)


def table_1_text(results: Results) -> str:
    """The origin of Table 1."""
    cells = [["equation", "gives", "", "Table 1", "unit", "follows", "remark"]]
    for row in results["table_1"]:
        numbers = [f"{row['gives']:.3f}", f"{row['implied']:.3f}", row["unit"], "yes" if row["follows"] else "no"]
        cells.append([row["equation"], row["quantity"], *numbers, row["remark"]])
    condition = results["boundary_condition"]
    angles = (THETA_0, *(condition[name] for name in ("largest_angle", "reached", "drift")))
    start, largest, reached, back = (f"{math.degrees(angle):.0f} degrees" for angle in angles)
    boundary = (
        f"The boundary condition theta(t3) = +{start}, on which (23), (30) and (31) rest, has another solution: V1 = "
        f"{condition['V1']:.2f} rad/s, with a largest angle of {largest}. With the published {V1:g} rad/s the pendulum "
        f"is at {reached} at t3, and the P3 of (23) would take it {back} too far back in every cycle."
    )
    follows = "Follows: the two agree within the digits of Table 1, all its times varied by half a last digit."
    return _section("What Table 1 follows from (Sect. 3.2)", cells, follows, boundary, left=2, last_left=True)


def principles_text(results: Results) -> str:
    """Principles and Lemmas on both profiles, and what the Lemmas imply."""
    tables = []
    for name, first in (("proposed", 3), ("EPC", 2)):
        phases = selection.ROMAN[first : first + RESTORING_PHASES]
        cells = [[name, "with", f"before {phases[0]}", *phases, "met"]]
        for row in (row for row in results["demands"] if row["profile"] == name):
            progressive = f"{row['progressive']:.3f}" if row["whole_cycle"] else f"({row['progressive']:.1f})"
            restoring = [f"{max(0.0, factor):.3f}" for factor in row["restoring"]]
            cells.append([row["demand"], row["form"], progressive, *restoring, "yes" if row["met"] else "no"])
        tables.append(cells)
    styles = {"lemma": "", "form": "", "principle": "", "states": ",", "violations": ",", "worst": ".4f"}
    lemmas = [["lemma", "with", "principle", "states that\nmeet it", "of these\nviolate", "largest load\nover limit"]]
    lemmas += [_formatted(row, styles) for row in results["lemmas"]]
    fast, slow = (
        f"|theta'| < {v:g} rad/s and |theta''| < {a:g} rad/s^2" for v, a in (principles.FAST, principles.SLOW)
    )
    return _section(
        "Principles 1 to 4 and Lemmas 1 and 2: largest load over limit (above 1: violated)",
        *tables,
        f"Nominal plant. Principle 4 and Lemma 2 apply to the restoring stage, the last {RESTORING_PHASES} phases. "
        "theta_0, v_theta and a_theta are not published: 60 degrees are the boundary condition of Sect. 3.2, and for "
        "Principle 2 the proposed profile's own largest values are used.",
        lemmas,
        f"Random states with |theta| < 90 degrees; for Lemma 1 {fast}, for Lemma 2 {slow}.",
        left=2,
    )


def optimal_profiles_text(results: Results) -> str:
    """The optima of the family of profiles (9)."""
    cells = [["torque limit, plants, changes", "cm/s", "cost of transport", "N m", "back", "binding"]]
    for each in sorted(results["optimal_profiles"], key=lambda each: each.problem.torque_limit):
        names = (name for name, share in each.shares.items() if share >= BINDING)
        binding = ", ".join(name.replace("principle_", "P").replace("_", " ") for name in names)
        numbers = [f"{each.cost_of_transport:.2f}", f"{each.peak_torque:.3f}", f"{100.0 * each.backward_ratio:.1f} %"]
        cells.append([each.problem.label, printed_below(100.0 * each.mean_speed, 3), *numbers, binding])
    return _section(
        "The optimum of the paper's own family of profiles, exact tracking, Principles 1 to 4",
        cells,
        f"Of the worst plant; 'binding': at {100.0 * BINDING:.0f} % of the limit or more (P2: Principle 2, and so on).",
        "The speeds are lower bounds of the optimum, rounded down: each problem has the best profile that the "
        "committed searches found, and other seeds may find a faster one.",
        last_left=True,
    )


def ranges_text(results: Results) -> str:
    """The adaptive law over the grid, in all its forms."""
    laws = results["adaptive"]["laws"]
    regularised, plants = laws[0], len(laws[0].runs)
    nominal = regularised.runs[plants // 2]
    cells = [["regularised law", "nominal", "worst", "unit", "at M (kg)", "mu"]]
    for label, name, unit, style in (
        ("tracking error, rms", "error_rms", "rad", ".1e"),
        ("largest theta'", "peak_velocity", "rad/s", ".3f"),
        ("largest torque", "peak_torque", "N m", ".3f"),
        ("mean speed, fastest", "mean_speed", "cm/s", ".3f"),
        ("mean speed, slowest", "mean_speed", "cm/s", ".3f"),
    ):
        worst = regularised.worst(name, smallest="slowest" in label)
        values = [format(run[name], style) for run in (nominal, worst)]
        cells.append([label, *values, unit, *_formatted(worst, {"M": ".3f", "mu": ".4f"})])
    parts: list[str | Cells] = [cells]
    for law in laws:
        limit = f", motor limited to {TORQUE_LIMIT:g} N m" if law.torque_limit == TORQUE_LIMIT else ""
        parts.append(f"{law.law}{limit}: {law.failures} of {len(law.runs)} plants fail")
    M, mu = ([*limits] for limits in (published.M_RANGE, published.MU_RANGE))
    return _section(
        f"Adaptive law (39), {plants} plants: M in {M} kg, mu in {mu}",
        *parts,
        f"Corrected, unregularised: beta = {UNREGULARISED.beta:g}, n = {UNREGULARISED.n}, eta(0) = "
        f"{UNREGULARISED.eta_0:g}, eta at most {UNREGULARISED.eta_bound:g}. Regularised: beta = {REGULARISED.beta:g}, "
        f"sgn(delta_theta) a saturation of {REGULARISED.saturation_width:g} rad/s, eta at most "
        f"{REGULARISED.eta_bound:g}, estimates within {100.0 * REGULARISED.estimate_range:.0f} % of nominal.",
    )


def choices_text(results: Results) -> str:
    """Failures of the adaptive law under other choices."""
    study = results["adaptive"]
    cells = [["beta", "eta(0)", "n", "law, kHz", "fail", f"motor of {TORQUE_LIMIT:g} N m"]]
    for beta, eta_0, n, rate, *failures in study["variants"]:
        cells.append([f"{beta:g}", f"{eta_0:g}", f"{n}", f"{rate / 1000:g}", *map(str, failures)])
    plants = len(study["laws"][1].runs)
    return _section(f"What the paper leaves open: plants of {plants} that fail, law corrected, unregularised", cells)


def long_runs_text(results: Results) -> str:
    """The errors of the regularised law over many cycles and at several rates."""
    labels = dict(zip(ERRORS, ("angle error, rad", "rate error, rad/s", "delta_theta, rad/s"), strict=True))
    columns = [(name, {f"cycle {n}": (n, RATES[0]) for n in adaptive.SHOWN_CYCLES}) for name in ERRORS]
    pairs = [(n, rate) for n in (1, LONG) for rate in RATES]
    columns.append(("sliding", {f"{rate / 1000:g} kHz\ncycle {n}": (n, rate) for n, rate in pairs}))
    tables = []
    for name, cycles in columns:
        found = [cycle_errors(results["adaptive"], name, *cycle) for cycle in cycles.values()]
        cells = [[labels[name], *cycles]]
        for (M, mu), *errors in zip((adaptive.NOMINAL_PLANT, *adaptive.CORNERS), *found, strict=True):
            cells.append([f"M = {M:g} kg, mu = {mu:g}", *(f"{error:.1e}" for error in errors)])
        tables.append(cells)
    return _section("Long runs of the regularised law: the largest error of a cycle", *tables)


def lyapunov_text(results: Results) -> str:
    """The Lyapunov function (40) along the runs."""
    cells = [["law", "M (kg)", "mu", "start", "end", "rises in\nof time", "rise\nin all", "fall\nin all"]]
    styles = {"M": ".2f", "mu": ".3f", "start": ".4f", "end": ".4f", "rising": ".0%", "rise": ".1e", "fall": ".1e"}
    for law in results["adaptive"]["laws"][:2]:
        cells += [[law.law, *_formatted(values, styles)] for values in law.lyapunov]
    return _section("The Lyapunov function V of (40) along the run, with the true plant's parameters", cells)
