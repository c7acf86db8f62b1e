"""The report's section on the optimum of the paper's family of profiles."""

from __future__ import annotations

import math

from baselines.paper.profile_problems import Solution
from baselines.paper.profile_records import Found, load
from baselines.paper.profile_settings import DATA, PROG
from baselines.paper.text.layout import paragraph, table, title
from baselines.tables import printed_below

# Share of its limit from which a demand counts as binding; the search keeps a reserve of about one percent.
BINDING = 0.98


def optimal_section() -> list[str]:
    """How much the paper's family of profiles holds."""
    lines = title("The optimum of the paper's own family of profiles, exact tracking, Principles 1 to 4")
    if not DATA.exists():
        return [*lines, f"Not computed yet: {PROG}"]
    found = load()
    cells = [["torque limit, plants, changes", "cm/s", "cost of transport", "N m", "back", "binding"]]
    cells += [_row(solution) for solution in sorted(found.solutions, key=lambda each: each.problem.torque_limit)]
    return [
        *lines,
        *table(cells),
        "",
        *paragraph(
            f"Of the worst plant; 'binding': at {100.0 * BINDING:.0f} % of the limit or more (P2: Principle 2, and so "
            "on). The published profile's own largest angle, velocity and acceleration are the bounds of Principles 1 "
            f"and 2. Computed by {PROG} and stored."
        ),
        "",
        *_reservations(found),
    ]


def _row(solution: Solution) -> list[str]:
    """A row of the table of optima."""
    if not solution.feasible:
        return [solution.problem.label, "-", "-", "-", "-", "no profile meets all demands"]
    cost, back = (math.nan if v is None else v for v in (solution.cost_of_transport, solution.backward_ratio))
    return [
        solution.problem.label,
        printed_below(100.0 * solution.mean_speed, 3),
        f"{cost:.2f}",
        f"{solution.peak_torque:.3f}",
        f"{100.0 * back:.1f} %",
        ", ".join(_demand(name) for name, share in solution.shares.items() if share >= BINDING),
    ]


def _demand(name: str) -> str:
    """A demand in few letters: principle_2_velocity is P2 velocity."""
    return name.replace("principle_", "P").replace("_", " ")


def _reservations(found: Found) -> list[str]:
    """What the searches cannot promise."""
    cells = [["one search with another seed", "searches", "found a profile", "slowest", "fastest"]]
    for spread in found.spreads:
        row = [spread.problem.label, str(len(spread.seeds)), str(len(spread.feasible))]
        cells.append([*row, *(f"{100.0 * change:+.1f} %" for change in found.against(spread))])
    return [
        *table(cells, last_left=False),
        "",
        *paragraph(
            "Reservations. The speeds are lower bounds of the optimum, rounded down: differential evolution proves "
            "nothing, and each problem is given the best profile that any of the searches found. The second table "
            "shows how far single searches come out from that: a little, but much where Principle 4 binds phase IV as "
            "well, which leaves a narrow set; there the best of several searches counts."
        ),
    ]
