"""The report's sections on the adaptive law: what it reaches, its open choices, its long runs, its inside."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED
from baselines.laws.profiles import PROPOSED
from baselines.paper import published
from baselines.paper.adaptive_study import (
    BETAS,
    DEVIATIONS,
    ETAS,
    EXPONENTS,
    GRID,
    LONG,
    RATES,
    REGULARISED_LAW,
    Adaptation,
    AdaptiveRun,
    AdaptiveStudy,
    LawStudy,
    LongRun,
)
from baselines.paper.text.layout import paragraph, title
from baselines.paper.traces import CYCLES
from baselines.tables import text_table
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import TORQUE_LIMIT

ERRORS = {"angle_error": "angle error, rad", "rate_error": "rate error, rad/s", "sliding": "delta_theta, rad/s"}


def _table(cells: Sequence[Sequence[str]]) -> list[str]:
    """A table's lines."""
    return text_table(cells, left=1, last_left=False).splitlines()


def _plant(run: LongRun) -> str:
    """M and mu of a run."""
    return f"M = {run.M:g} kg, mu = {run.mu:g}"


def _of(study: LawStudy) -> str:
    """The form of the law, and its motor where that is limited."""
    limited = f", motor limited to {study.torque_limit:g} N m"
    return study.law + (limited if study.torque_limit == TORQUE_LIMIT else "")


def adaptive_section(study: AdaptiveStudy) -> list[str]:
    """The adaptive law over the grid, in all its forms."""
    M, mu = published.M_RANGE, published.MU_RANGE
    lines = title(f"Adaptive law (39), {GRID} x {GRID} plants: M in {list(M)} kg, mu in {list(mu)}")
    regularised = study.laws[0]
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
    lines += [*_table(cells), ""]
    for law in study.laws:
        lines.append(f"{_of(law)}: {law.failures} of {len(law.runs)} plants fail")
    lines += ["", *_failures(study.laws[1]), "", *_failures(study.laws[2]), ""]
    lines += paragraph(
        "Corrected, unregularised: the typing errors of (37) to (39) mended, norms in (39c) and (39d), and what the "
        f"paper leaves open chosen: beta = {UNREGULARISED.beta:g}, n = {UNREGULARISED.n}, eta(0) = "
        f"{UNREGULARISED.eta_0:g}, eta at most {UNREGULARISED.eta_bound:g}, Euler steps at 1 kHz, N from theta_d''. "
        f"Regularised: beta = {REGULARISED.beta:g}, sgn(delta_theta) a saturation of {REGULARISED.saturation_width:g} "
        f"rad/s, eta at most {REGULARISED.eta_bound:g}, estimates within {100.0 * REGULARISED.estimate_range:.0f} % of "
        "nominal, x_d anchored anew to the platform at every cycle."
    )
    return lines + paragraph(
        "Why it fails: x_d is integrated from the nominal plant and never corrected, so that off the nominal plant the "
        "platform leaves it by millimetres within the first swing. delta_x = e_x' + "
        f"{PUBLISHED.Lambda_x:g} e_x is then 5 to 10 cm/s, and T_n answers with -sgn(delta_theta) |delta_x| (|eta| + "
        "K2) - (eta + 1) K3 delta_x^2 delta_theta / (delta_theta^2 + beta): several N m on top of 1.3, which change "
        f"sign with delta_theta from call to call and lift the platform off. A motor of {TORQUE_LIMIT:g} N m saves "
        "some plants; on those eta, whose rate (39d), given its norm, is never negative, grows with delta_x^2 to its "
        "numerical bound, and the torque switches between its limits."
    )


def _failures(study: LawStudy) -> list[str]:
    """When each plant of a form of the law fails, and what the law's variables are then."""
    lines = [f"{_of(study)}: seconds until it fails ('-': lasts 33 s), M in kg by mu"]
    columns = [study.runs[i : i + GRID] for i in range(0, len(study.runs), GRID)]
    cells = [["", *(f"{run.mu:.4f}" for run in columns[0])]]
    cells += [[f"{row[0].M:.3f}", *(f"{run.until:.3f}" if run.ending else "-" for run in row)] for row in columns]
    lines += [line for i, line in enumerate(_table(cells)) if i != 1]
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


def choices_section(study: AdaptiveStudy) -> list[str]:
    """What the choices that the paper leaves open change, and how far from the nominal plant the law lasts."""
    plants = len(study.laws[1].runs)
    lines = title(f"What the paper leaves open: plants of {plants} that fail, law corrected, unregularised")
    cells = [["beta", "eta(0)", "n", "law, kHz", "fail", f"motor of {TORQUE_LIMIT:g} N m"]]
    for v in study.variants:
        cells.append(
            [
                f"{v.beta:g}",
                f"{v.eta_0:g}",
                f"{v.n}",
                f"{v.rate / 1000:g}",
                f"{v.failures}",
                f"{v.failures_limited}",
            ]
        )
    free, limited = ([getattr(v, name) for v in study.variants] for name in ("failures", "failures_limited"))
    lines += [*_table(cells), ""]
    lines += paragraph(
        f"Over beta from {BETAS[0]:g} to {BETAS[-1]:g}, eta(0) from {ETAS[0]:g} to {ETAS[-1]:g}, n from {EXPONENTS[0]} "
        f"to {EXPONENTS[-1]} and {RATES[0] // 1000} to {RATES[-1] // 1000} kHz, one at a time and at corners: "
        f"{min(free)} to {max(free)} of {plants} plants fail, {min(limited)} to {max(limited)} with the motor limited. "
        f"{plants - GRID} plants have another mass than the nominal one."
    )
    lines += [
        "",
        f"Seconds until the same law fails off the nominal plant ('-': lasts {LONG} cycles), at its own choices",
    ]
    cells = [["off by", "M less", "M more", "mu less", "mu more"]]
    until = {(d.parameter, d.percent): d.until for d in study.deviations}
    for percent in DEVIATIONS:
        found = [until[name, sign * percent] for name in ("M", "mu") for sign in (-1.0, 1.0)]
        cells.append([f"{percent:g} %", *("-" if t is None else f"{t:.1f}" for t in found)])
    lines += [*_table(cells), ""]
    duration = CYCLES * PROPOSED.period
    lasts = [_lasting(study, name, duration) for name in ("M", "mu")]
    return lines + paragraph(
        f"For {duration:g} s it bears M off by {lasts[0]}, or mu off by {lasts[1]}, to either side."
    )


def _lasting(study: AdaptiveStudy, parameter: str, duration: float) -> str:
    """The largest deviation up to which every one, to either side, lasts that long."""
    failing = [
        abs(d.percent) for d in study.deviations if d.parameter == parameter and (d.until or duration) < duration
    ]
    borne = [percent for percent in DEVIATIONS if percent < min(failing, default=100.0)]
    return f"{borne[-1]:g} %" if borne else "none"


def long_runs_section(study: AdaptiveStudy) -> list[str]:
    """The errors of the regularised law over many cycles, and what the torque's hold has to do with them."""
    lines = title("Long runs of the regularised law: the largest error of a cycle")
    longest = [study.on_nominal(), *study.off_nominal()]
    for quantity, label in ERRORS.items():
        cells = [[label, *(f"cycle {cycle}" for cycle in longest[0].cycles)]]
        for run in longest:
            cells.append([_plant(run), *(f"{value:.1e}" for value in getattr(run, quantity))])
        lines += [*_table(cells), ""]
    cells = [[ERRORS["sliding"], *(f"{rate / 1000:g} kHz\ncycle {cycle}" for cycle in (1, LONG) for rate in RATES)]]
    for i, run in enumerate(longest):
        held = [[study.on_nominal(rate), *study.off_nominal(rate)][i] for rate in RATES]
        cells.append([_plant(run), *(f"{each.at('sliding', cycle):.1e}" for cycle in (1, LONG) for each in held)])
    lines += [*_table(cells), ""]
    return lines + paragraph(
        "On the nominal plant the errors go with the law's period: they are those of a torque that is held, and in the "
        "limit nothing is left of them. Off it they hardly do. They fall while the estimates of alpha_theta adapt, "
        "wander below the first cycle's from then on, and do not vanish: every cycle starts x_d anew and excites them."
    )


def estimates_section(study: AdaptiveStudy) -> list[str]:
    """The course of the estimates and of eta on the plant farthest from nominal in each form."""
    lines = title("Estimates and eta of the regularised law")
    for M, mu in (
        (NOMINAL.M, NOMINAL.mu),
        (published.M_RANGE[0], published.MU_RANGE[0]),
        (published.M_RANGE[1], published.MU_RANGE[1]),
    ):
        cells = [[f"M = {M:g} kg, mu = {mu:g}", "true", "start", "end", "lowest", "highest", "nears the truth"]]
        for course in study.adaptation(REGULARISED_LAW, M, mu).courses:
            nears = {None: "", True: "yes", False: "no"}[course.approached]
            true = "" if course.true is None else f"{course.true:.5f}"
            numbers = [f"{value:.5f}" for value in (course.start, course.end, course.low, course.high)]
            cells.append([course.name, true, *numbers, nears])
        lines += [*_table(cells), ""]
    return lines + paragraph(
        "The estimates do not converge to the plant, and need not: (39e) moves them along the error of tracking, and "
        "stops with it, wherever they are. Those of alpha_x answer to delta_x, which stays because theta alone is "
        "controlled; they walk to the bounds that the regularised law sets (half and three halves of nominal)."
    )


def lyapunov_section(study: AdaptiveStudy) -> list[str]:
    """The Lyapunov function (40) along the runs."""
    lines = title("The Lyapunov function V of (40) along the run, with the true plant's parameters")
    cells = [
        [
            "law",
            "M (kg)",
            "mu",
            "start",
            "end",
            "highest",
            "rises in\nof time",
            "rise\nin all",
            "fall\nin all",
            "V' > 0\nby (41)",
            "risen while slipping\nwith w < 0",
        ]
    ]
    cells += [_descent_row(adaptation) for adaptation in study.inside]
    lines += [*_table(cells), ""]
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
