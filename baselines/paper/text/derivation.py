"""The report's sections on Sections 2 and 3 of the paper: Property 3, the profile (9), and where Table 1 comes from."""

from __future__ import annotations

import math
from collections.abc import Sequence

from baselines.laws.profiles import V1
from baselines.paper.linearity import Linearity
from baselines.paper.printed_profile import PrintedPhase
from baselines.paper.selection import THETA_0, BoundaryCondition, Consequence
from baselines.paper.text.layout import paragraph, table, title


def linearity_section(found: Linearity) -> list[str]:
    """Property 3."""
    return title("Property 3: the model is linear in its constants") + paragraph(
        "M(q) q'' + C(q, q') q' + G(q), the left side of (4), is Y alpha with alpha = [m l^2, m l, M + m, m g l] and "
        f"Y_0 = 0, to {found.residual:.0e} of its terms on random motions and plants: Property 3 holds. But (4) leaves "
        "out K q and F_d, which (1) has. K q and the damper are linear as well; the friction mu N sign(x') is linear "
        f"in the products mu (M + m) and mu m l ({found.products:.0e}) and not in mu and the masses: half-way between "
        f"two opposite corners of the paper's ranges it lies {100.0 * found.defect:.1f} % off the straight line. The "
        "law (39) takes N for a known function and estimates mu alone. Remark 4 cites a Property 4, which the paper "
        "does not have."
    )


def profile_section(phases: Sequence[PrintedPhase]) -> list[str]:
    """The profile (9) as printed and as built."""
    cells = [["phase", "as printed", "begins", "ends", "turns, deg", "built: begins", "ends", "turns, deg", ""]]
    for phase in phases:
        numbers = [phase.begins, phase.ends, math.degrees(phase.turns)]
        built = [phase.built_begins, phase.built_ends, math.degrees(phase.built_turns)]
        cells.append(
            [
                phase.name,
                phase.printed,
                # -0.0 is not meant.
                *(f"{value + 0.0:.3f}" for value in (*numbers, *built)),
                "deviates" if phase.deviates else "",
            ]
        )
    drift = math.degrees(sum(phase.turns for phase in phases))
    return [
        *title("The profile (9) as printed, and as built (velocities in rad/s)"),
        *table(cells, left=2),
        "",
        *paragraph(
            "With omega = pi / (2 t1) and the V1, P2 and P3 that are built. As printed it jumps at every edge from t2 "
            f"on and turns the pendulum by {drift:.0f} degrees a cycle. III lacks the phase with which the cosine "
            "falls from P1 omega to P2; in IV, V and VII every index of a time is one too low, and "
            "VI has an interval of three numbers."
        ),
    ]


def table_1_section(rows: Sequence[Consequence], condition: BoundaryCondition) -> list[str]:
    """What Table 1 follows from, and what the boundary condition behind (23) would take."""
    cells = [["equation", "gives", "", "Table 1", "unit", "follows", "remark"]]
    for row in rows:
        follows = "yes" if row.follows else "no"
        cells.append(
            [row.equation, row.quantity, f"{row.gives:.3f}", f"{row.implied:.3f}", row.unit, follows, row.remark]
        )
    return [
        *title("What Table 1 follows from (Sect. 3.2)"),
        *table(cells, left=2),
        "",
        *paragraph("Follows: the two agree within the digits of Table 1, all its times varied by half a last digit."),
        *paragraph(
            f"The boundary condition theta(t3) = +{math.degrees(THETA_0):.0f} degrees, on which (23) and with it (30) "
            f"and (31) rest, has another solution: V1 = {condition.V1:.2f} rad/s, with a largest angle of "
            f"{math.degrees(condition.largest_angle):.0f} degrees. With the published {V1:g} rad/s the pendulum is at "
            f"{math.degrees(condition.reached):.0f} degrees at t3, and the P3 of (23) would take it "
            f"{math.degrees(condition.drift):.0f} degrees too far back in every cycle. The profile that is built "
            "closes instead, by its P3."
        ),
    ]
