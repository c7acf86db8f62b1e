"""The report's sections on the adaptive law: what it reaches, its estimates, its Lyapunov function."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.paper import published
from baselines.paper.reproduction import GRID, Adaptation, AdaptiveRun, LawStudy, Reproduction
from baselines.paper.text.layout import paragraph, table, title


def adaptive_section(result: Reproduction) -> list[str]:
    """The adaptive law over the grid, in all its forms."""
    M, mu = published.M_RANGE, published.MU_RANGE
    lines = title(f"Adaptive law (39), {GRID} x {GRID} plants: M in {list(M)} kg, mu in {list(mu)}")
    regularised = result.laws[0]
    measures = [
        ("tracking error, rms", "error_rms", "rad", ".1e"),
        ("tracking error, largest", "error_max", "rad", ".1e"),
        ("largest theta'", "peak_velocity", "rad/s", ".3f"),
        ("largest torque", "peak_torque", "N m", ".3f"),
        ("mean speed, fastest", "mean_speed", "cm/s", ".3f"),
        ("mean speed, slowest", "mean_speed", "cm/s", ".3f"),
        ("|x - x_d|", "drift", "m", ".4f"),
        ("|T_n|", "auxiliary_torque", "N m", ".3f"),
    ]
    nominal = regularised.runs[len(regularised.runs) // 2]
    cells = [["regularised law", "nominal", "worst", "unit", "at M (kg)", "mu"]]
    for label, name, unit, style in measures:
        run = regularised.worst(name, smallest="slowest" in label)
        cells.append(
            [
                label,
                format(getattr(nominal, name), style),
                format(getattr(run, name), style),
                unit,
                f"{run.M:.3f}",
                f"{run.mu:.4f}",
            ]
        )
    lines += [*table(cells), ""]
    for study in result.laws:
        lines.append(f"{study.law}: {study.failures} of {len(study.runs)} plants fail")
    lines += ["", *_failures(result.laws[1]), "", *_failures(result.laws[2]), ""]
    lines += paragraph(
        "Why: x_d is integrated from the nominal plant and never corrected, so that off the nominal plant the platform "
        "leaves it by millimetres within the first swing. delta_x = e_x' + 30 e_x is then 5 to 10 cm/s, and T_n "
        "answers with -sgn(delta_theta) |delta_x| (|eta| + K2) - (eta + 1) K3 delta_x^2 delta_theta / (delta_theta^2 + "
        "beta): several N m on top of 1.3, which change sign with delta_theta from call to call and lift the platform "
        "off. A motor limited to 1.5 N m saves some plants; on those eta, whose rate (39d), given its norm, is never "
        "negative, grows with delta_x^2 to its numerical bound, and the torque switches between its limits."
    )
    return lines


def _failures(study: LawStudy) -> list[str]:
    """When each plant of a form of the law fails, and what the law's variables are then."""
    lines = [f"{study.law}: seconds until it fails ('-': lasts 33 s), the rows M in kg, the columns mu"]
    columns = [study.runs[i : i + GRID] for i in range(0, len(study.runs), GRID)]
    cells = [["", *(f"{run.mu:.4f}" for run in columns[0])]]
    cells += [[f"{row[0].M:.3f}", *(f"{run.until:.3f}" if run.ending else "-" for run in row)] for row in columns]
    lines += [line for i, line in enumerate(table(cells)) if i != 1]
    failed = [run for run in study.runs if run.ending]
    if failed:
        endings = sorted({run.ending for run in failed})
        lines += paragraph(
            f"Of those that fail ({', '.join(endings)}): |x - x_d| at most {_span(failed, 'drift', '.4f')} m, |T_n| "
            f"{_span(failed, 'auxiliary_torque', '.3g')} N m, eta {_span(failed, 'eta', '.4g')}."
        )
    lasted = [run for run in study.runs if not run.ending]
    if lasted:
        lines += paragraph(
            f"Of those that last: |x - x_d| {_span(lasted, 'drift', '.1e')} m, |T_n| (before the motor's limit) "
            f"{_span(lasted, 'auxiliary_torque', '.1e')} N m, eta {_span(lasted, 'eta', '.4g')}."
        )
    return lines


def _span(runs: Sequence[AdaptiveRun], name: str, style: str) -> str:
    """Smallest and largest value of a number."""
    values = [float(getattr(run, name)) for run in runs]
    return format(values[0], style) if len(values) == 1 else f"{min(values):{style}} to {max(values):{style}}"


def estimates_section(result: Reproduction) -> list[str]:
    """The course of the estimates and of eta on the plant farthest from nominal in each form."""
    lines = title("Estimates and eta of the regularised law")
    for M, mu in (
        (0.5, 0.01),
        (published.M_RANGE[0], published.MU_RANGE[0]),
        (published.M_RANGE[1], published.MU_RANGE[1]),
    ):
        cells = [[f"M = {M:g} kg, mu = {mu:g}", "true", "start", "end", "lowest", "highest", "nears the truth"]]
        for course in result.adaptation("regularised", M, mu).courses:
            nears = {None: "", True: "yes", False: "no"}[course.approached]
            true = "" if course.true is None else f"{course.true:.5f}"
            numbers = [f"{value:.5f}" for value in (course.start, course.end, course.low, course.high)]
            cells.append([course.name, true, *numbers, nears])
        lines += [*table(cells), ""]
    return lines + paragraph(
        "The estimates do not converge to the plant, and need not: (39e) moves them along the error of tracking, and "
        "stops with it, wherever they are. Those of alpha_x answer to delta_x, which stays because theta alone is "
        "controlled; they walk to the bounds that the regularised law sets (half and three halves of nominal)."
    )


def lyapunov_section(result: Reproduction) -> list[str]:
    """The Lyapunov function (40) along the runs."""
    lines = title("The Lyapunov function V of (40) along the run, with the true plant's parameters")
    head = [
        "law",
        "M (kg)",
        "mu",
        "start",
        "end",
        "highest",
        "rises in",
        "rise",
        "fall",
        "V' > 0",
        "risen while slipping",
    ]
    units = ["", "", "", "", "", "", "of time", "in all", "in all", "by (41)", "with w < 0"]
    cells = [head, units]
    for adaptation in result.inside:
        cells.append(_descent_row(adaptation))
    block = table(cells)
    block[1], block[2] = block[2], block[1]
    lines += [*block, ""]
    return lines + paragraph(
        "V rises. With s = delta_theta^2 / (delta_theta^2 + beta), w = delta_x Y_x alpha^_x and W = |w| the law "
        "leaves V' = -K1 delta_theta^2 - |delta_theta delta_x| (eta + K2) - s K3 delta_x^2 + s W - w, given the norm "
        "in (39d) that (41) uses and the print lacks. (41) drops s W - w as if it were never positive. That is right "
        "for w >= 0; for w < 0 it is (1 + s) W > 0, and without the norm (1 + s - 2 eta s) W, positive for eta near 1 "
        "as well. Nothing bounds W by the terms that fall: they vanish with delta_theta and w does not. So the norm "
        "alone does not repair (41). '(41)': fraction of the slipping time in which that sum is positive. The last "
        "column: share of the whole rise that happens there. In stick (38) itself fails, since f is then the "
        "reaction, not mu N sign(x')."
    )


def _descent_row(adaptation: Adaptation) -> list[str]:
    """A row of the table above."""
    d = adaptation.descent
    share = next(value for name, value in d.rise_by_cause.items() if name.endswith("< 0"))
    return [
        adaptation.law,
        f"{adaptation.M:.2f}",
        f"{adaptation.mu:.3f}",
        f"{d.start:.4f}",
        f"{d.end:.4f}",
        f"{d.highest:.4f}",
        f"{100.0 * d.rising:.0f} %",
        f"{d.rise:.1e}",
        f"{d.fall:.1e}",
        f"{100.0 * d.positive:.0f} %",
        f"{100.0 * share:.0f} %",
    ]
