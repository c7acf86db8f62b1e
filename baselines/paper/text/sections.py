"""The report of `python -m baselines.paper`: one function per section, each returning lines for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from baselines.paper.proofs import Envelope, PeakTorque
from baselines.paper.reproduction import Reproduction
from baselines.paper.text.layout import paragraph, printed, table, title
from baselines.paper.verdicts import AGREEMENT, CONSTANT, Judgement, Row

# Share of its limit from which a demand counts as binding; the search keeps a reserve of about one percent.
BINDING = 0.98


def numbers_section(rows: Sequence[Row]) -> list[str]:
    """Published and found."""
    cells = [["run", "quantity", "unit", "published", "found", "difference", "kind", "verdict"]]
    notes = []
    for row in rows:
        # One more digit than print, so that rounding hides nothing.
        found = f"{row.found:.{row.number.digits + 1}f}"
        verdict = "reproduced" if row.reproduced else "NOT reproduced"
        remark = row.note if row.reproduced else row.reason
        if remark:
            notes.append(remark)
            verdict += f" [{len(notes)}]"
        cells.append(
            [
                row.run,
                row.number.quantity,
                row.number.unit,
                printed(row.number),
                found,
                f"{100.0 * row.difference:+.1f} %".replace("-0.0", "+0.0"),
                row.kind,
                verdict,
            ]
        )
    lines = title("Section 5 of the paper: published and found") + table(cells, left=3)
    lines += [""]
    lines += paragraph(
        "'calibrated': a free parameter of the profile (V1, P2) was set to meet it, so that it proves nothing; "
        f"'predicted': nothing was set; '{CONSTANT}': restates the plant. Reproduced means within "
        f"{100.0 * AGREEMENT:.0f} %. Five cycles from rest, mu = 0.01, Newton's normal force, feedback linearisation "
        "(35) at 1 kHz."
    )
    for n, note in enumerate(notes, 1):
        lines += paragraph(note, "     ", f" [{n}] ")
    return lines


def claims_section(judgements: Sequence[Judgement]) -> list[str]:
    """Claims without a number of their own."""
    lines = title("What the paper claims of them")
    for judgement in judgements:
        verdict = "reproduced" if judgement.reproduced else "NOT reproduced"
        lines += paragraph(f"{judgement.claim.text} ({judgement.claim.where}): {verdict}", "  ", "- ")
        lines += paragraph(judgement.found + ".", "  ", "  ")
    return lines


def tracking_section(result: Reproduction) -> list[str]:
    """Both profiles, both options for the normal force."""
    head = ["profile", "normal force", "theta'", "swing", "speed", "torque", "energy", "cost of", "back", "rms error"]
    units = ["", "", "rad/s", "deg", "cm/s", "N m", "J/cycle", "transport", "cm/cycle", "rad"]
    cells = [head, units]
    for run in result.tracking:
        cells.append(
            [
                run.profile,
                run.contact,
                f"{run.peak_velocity:.3f}",
                f"{run.largest_angle_deg:.2f}",
                f"{run.mean_speed:.4f}",
                f"{run.peak_torque:.4f}",
                f"{run.energy:.3f}",
                f"{run.cost_of_transport:.3f}",
                f"{run.backward:.3f}",
                f"{run.error:.1e}",
            ]
        )
    lines = table(cells, left=2)
    # The units belong above the rule.
    lines[1], lines[2] = lines[2], lines[1]
    change = max(
        abs(coarse.mean_speed / fine.mean_speed - 1.0)
        for coarse, fine in zip((result.run("proposed"), result.run("EPC")), result.refined, strict=True)
    )
    return (
        title("Both profiles under feedback linearisation (35)")
        + lines
        + ["", f"Physics steps of 0.1 ms instead of 1 ms change the speeds by {change:.0e} of their value."]
    )


def selection_section() -> list[str]:
    """What Table 1 follows from."""
    from baselines.paper.selection import what_follows

    cells = [["equation", "gives", "", "Table 1", "unit", "follows", "remark"]]
    for row in what_follows():
        follows = "yes" if row.follows else "no"
        cells.append(
            [row.equation, row.quantity, f"{row.gives:.3f}", f"{row.implied:.3f}", row.unit, follows, row.remark]
        )
    return (
        title("What Table 1 follows from (Sect. 3.2)")
        + table(cells, left=2)
        + ["", "Follows: the two agree within the digits of Table 1, all its times varied by half a last digit."]
    )


def optimal_section() -> list[str]:
    """How much the paper's family of profiles holds."""
    from baselines.paper.optimal_profiles import DATA, load

    lines = title("The optimum of the paper's own family of profiles, exact tracking, Principles 1 to 4")
    if not DATA.exists():
        return [*lines, "Not computed yet: python -m baselines.paper.optimal_profiles"]
    cells = [["torque limit, plants, changes", "cm/s", "cost of transport", "N m", "back", "binding"]]
    for solution in sorted(load(), key=lambda solution: solution.problem.torque_limit):
        if not solution.feasible:
            cells.append([solution.problem.label, "-", "-", "-", "-", "no profile meets all demands"])
            continue
        cost, back = (math.nan if v is None else v for v in (solution.cost_of_transport, solution.backward_ratio))
        binding = [_demand(name) for name, share in solution.shares.items() if share >= BINDING]
        cells.append(
            [
                solution.problem.label,
                f"{100.0 * solution.mean_speed:.3f}",
                f"{cost:.2f}",
                f"{solution.peak_torque:.3f}",
                f"{100.0 * back:.1f} %",
                ", ".join(binding),
            ]
        )
    lines += [*table(cells), ""]
    return lines + paragraph(
        f"Of the worst plant; 'binding': at {100.0 * BINDING:.0f} % of the limit or more (P2: Principle 2, and so on). "
        "The published profile's own largest angle, velocity and acceleration are the bounds of Principles 1 and 2. "
        "Computed by python -m baselines.paper.optimal_profiles and stored."
    )


def _demand(name: str) -> str:
    """A demand in few letters: principle_2_velocity is P2 velocity."""
    return name.replace("principle_", "P").replace("_", " ")


def proofs_section(peaks: Sequence[PeakTorque], envelopes: Sequence[Envelope]) -> list[str]:
    """Both proofs."""
    lines = title("Why the published torques are impossible: two proofs")
    lines += paragraph(
        "Proof 1, at the peak. Where theta' peaks theta'' = 0, and (1) leaves no freedom but the contact. The motor "
        "then gives at least the torque below, for every angle of the published swing, either direction of slip, "
        "stick, and either normal force; the margin between the samples is included."
    )
    cells = [["profile", "theta'", "published", "at least", "sticking", "|theta| < 90 deg", "at", "with"]]
    for peak in peaks:
        cells.append(
            [
                peak.name,
                f"{peak.velocity:g} rad/s",
                f"{peak.published:.4f} N m",
                f"{peak.bound:.4f}",
                f"{peak.sticking:.4f}",
                f"{peak.anywhere:.4f}",
                f"{math.degrees(peak.angle):.1f} deg",
                peak.mode,
            ]
        )
    lines += [*table(cells), ""]
    lines += paragraph(
        "Proof 2, in the phase plane. On every stretch with theta' > 0, d(theta'^2)/dtheta = 2 theta'', which is "
        "largest at full torque and in the contact mode that favours it. The solution of that equation from rest is "
        "an envelope that no motion with |u| within the limit crosses, whatever the reference, the law or the gains."
    )
    cells = [["profile", "limit", "published", "theta' below", "from -60 deg", "needed at least", "enough", "if c = 0"]]
    for envelope in envelopes:
        cells.append(
            [
                envelope.name,
                f"{envelope.torque:.4f} N m",
                f"{envelope.published:g} rad/s",
                f"{envelope.bound:.2f} rad/s",
                f"{envelope.from_start:.2f}",
                f"{envelope.torque_needed:.3f} N m",
                f"{envelope.torque_enough:.3f} N m",
                f"{envelope.undamped:.1f} rad/s",
            ]
        )
    verdict = all([*(peak.holds for peak in peaks), *(envelope.holds for envelope in envelopes)])
    lines += [*table(cells), ""]
    return lines + paragraph(
        "'theta' below': from rest anywhere within the published swing to either side. 'needed': no torque below it "
        "takes the pendulum from rest at -60 degrees to the published velocity; 'enough': a constant torque that "
        "does. 'if c = 0': the envelope from -60 degrees without the damper, which would admit the published "
        "velocity: the damper is what the published torques cannot pay for. All four hold: "
        f"{'yes' if verdict else 'NO'}."
    )


def sensitivity_section(result: Reproduction) -> list[str]:
    """Friction, normal force, steps."""
    lines = title("Sensitivity")
    cells = [["normal force", *(f"mu = {mu:g}" for mu in result.contacts[0].mu), ""]]
    for effect in result.contacts:
        cells.append([f"{effect.profile}, newton, cm/s", *(f"{speed:.3f}" for speed in effect.newton), ""])
        cells.append([f"{effect.profile}, paper, cm/s", *(f"{speed:.3f}" for speed in effect.paper), ""])
    lines += [*table(cells), ""]
    cells = [
        ["step, ms", "proposed, cm/s", "N m", "EPC, cm/s", "N m", "| law held 10 ms:", "cm/s", "N m", "cm/s", "N m", ""]
    ]
    for n, step in enumerate(result.steps[0].steps):
        row = [f"{1e3 * step:g}"]
        for group in (result.steps, result.physics_steps):
            for study in group:
                row += [f"{study.speed[n]:.5f}", f"{study.peak_torque[n]:.5f}"]
            if group is result.steps:
                row.append("|")
        cells.append([*row, ""])
    lines += [*table(cells), ""]
    return lines + paragraph(
        "Left: law and physics at the same step, as a simulation with one fixed step has it; what changes is the "
        "torque's hold, not the integrator. Right: the law at 10 ms throughout, the physics alone refined. The law "
        "runs at 1 kHz everywhere else."
    )
