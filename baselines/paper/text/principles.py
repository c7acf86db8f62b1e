"""The report's section on Principles 1 to 4 and Lemmas 1 and 2."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.paper.demand_study import FLYING, STANDING, Implication, Keeping
from baselines.paper.principles import RESTORING_PHASES
from baselines.paper.text.layout import paragraph, table, title


def principles_section(keepings: Sequence[Keeping], implications: Sequence[Implication]) -> list[str]:
    """What the profiles keep, and what implies what."""
    return [
        *title("Principles 1 to 4 and Lemmas 1 and 2: largest load over limit (above 1: violated)"),
        *_keepings(keepings),
        "",
        *_implications(implications),
    ]


def _keepings(keepings: Sequence[Keeping]) -> list[str]:
    """Every demand for both profiles, by phase."""
    lines: list[str] = []
    for name in dict.fromkeys(keeping.profile for keeping in keepings):
        last = ["IV", "V", "VI", "VII"] if name == "proposed" else ["III", "IV", "V", "VI"]
        cells = [[name, "with", f"before {last[0]}", *last, "kept"]]
        for keeping in keepings:
            if keeping.profile != name:
                continue
            progressive = f"{keeping.progressive:.3f}" if keeping.throughout else f"({keeping.progressive:.1f})"
            verdict = "yes" if keeping.kept else "no"
            restoring = [f"{max(0.0, factor):.3f}" for factor in keeping.restoring]
            cells.append([keeping.demand, keeping.form, progressive, *restoring, verdict])
        lines += [*table(cells, left=2), ""]
    return lines + paragraph(
        f"Nominal plant. Principle 4 and Lemma 2 are asked of the restoring stage alone, the last {RESTORING_PHASES} "
        "phases: before it (in brackets) a violation is what moves the capsule. theta_0, v_theta and a_theta are not "
        "published: 60 degrees are the boundary condition of Sect. 3.2, which the published swings of both profiles "
        "break; for Principle 2 the proposed profile's own largest values stand in. Lemma 2 as printed is met with "
        "equality at t3, but for the digits of Table 1: that is (27)."
    )


def _implications(implications: Sequence[Implication]) -> list[str]:
    """What the lemmas imply."""
    cells = [
        [
            "lemma",
            "with",
            "principle",
            "random states\nthat meet the lemma",
            "of these\nviolate",
            "largest load\nover limit",
        ]
    ]
    for row in implications:
        counts = [f"{row.states:,}", f"{row.violations:,}", f"{row.worst:.4f}"]
        cells.append([row.lemma, row.form, row.principle, *counts])
    return [
        *table(cells, left=3, last_left=False),
        "",
        *paragraph(
            f"Random: |theta| < 90 degrees, for Lemma 1 |theta'| < {FLYING[0]:g} rad/s and |theta''| < {FLYING[1]:g} "
            f"rad/s^2, for Lemma 2 {STANDING[0]:g} and {STANDING[1]:g}."
        ),
        *paragraph(
            "Lemma 1: (12) is sufficient for Principle 3, by Cauchy and Schwarz. The step to (13) uses a^2 + b^2 >= 2 "
            "a b, so (12) implies (10) and never the other way round: (10) is sufficient for nothing. Lemma 2: (15) "
            "bounds a sum without absolute values and adds a torque to an acceleration. Mended, |theta'' + (k theta + "
            "c theta') / (m l)| + theta'^2 <= (M + m) g / (m l) mu / sqrt(mu^2 + 1), without the pivot's torque for "
            "Newton's forces, it is sufficient for Principle 4, by the same inequality."
        ),
    ]
