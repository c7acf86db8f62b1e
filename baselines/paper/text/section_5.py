"""The report's sections on Section 5 of the paper: its numbers, its claims, and the runs behind ours."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.paper.reproduction import Reproduction
from baselines.paper.text.layout import paragraph, printed, table, title
from baselines.paper.verdicts import AGREEMENT, CONSTANT, Judgement, Row


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
        "(35) at 1 kHz. The numbers are those of the paper's text: its curves are not available as data."
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
    head = ["profile", "normal force", "theta'\nrad/s", "swing\ndeg", "speed\ncm/s", "torque\nN m", "energy\nJ/cycle"]
    cells = [[*head, "cost of\ntransport", "back\ncm/cycle", "rms error\nrad"]]
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
    change = max(
        abs(coarse.mean_speed / fine.mean_speed - 1.0)
        for coarse, fine in zip((result.run("proposed"), result.run("EPC")), result.refined, strict=True)
    )
    return (
        title("Both profiles under feedback linearisation (35)")
        + table(cells, left=2, last_left=False)
        + ["", f"Physics steps of 0.1 ms instead of 1 ms change the speeds by {change:.0e} of their value."]
    )
