"""What the paper says of the adaptive law beside ours: its one number, Theorem 1, and the claims of Figures 6 to 9."""

from __future__ import annotations

import math
from collections.abc import Sequence

from baselines.laws.gains import UNREGULARISED
from baselines.paper import published
from baselines.paper.adaptive_study import LONG, LONGEST, RATES, AdaptiveStudy, LongRun
from baselines.paper.verdicts import CALIBRATED, Judgement, Row
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import TORQUE_LIMIT

# An error has converged, as far as a run of finite length can show it, once it has fallen to this share of the first
# cycle's on every plant.
CONVERGED = 0.1


def compare_adaptive(study: AdaptiveStudy) -> Row:
    """The published number of the adaptive law beside ours."""
    regularised = study.laws[0]
    fastest = regularised.worst("peak_velocity")
    slowest = regularised.worst("peak_velocity", smallest=True)
    note = (
        f"printed as 'about'; {slowest.peak_velocity:.2f} to {fastest.peak_velocity:.2f} rad/s over the ranges, the "
        f"largest at M = {fastest.M:.3f} kg, mu = {fastest.mu:.4f}"
    )
    return Row("adaptive", published.ADAPTIVE_PEAK_VELOCITY, fastest.peak_velocity, CALIBRATED, note=note)


def converged(runs: Sequence[LongRun], quantity: str) -> bool:
    """Whether an error falls to a tenth of the first cycle's in every one of the runs."""
    return all(run.at(quantity, run.cycles[-1]) <= CONVERGED * run.at(quantity, 1) for run in runs)


def judge_adaptive(study: AdaptiveStudy) -> list[Judgement]:
    """Every claim on the adaptive law beside what was found."""
    regularised, corrected, limited = study.laws
    worst, highest = regularised.worst("error_rms"), limited.worst("eta")
    free, saturated = (
        [getattr(variant, name) for variant in study.variants] for name in ("failures", "failures_limited")
    )
    over_choices = f"{min(free)} to {max(free)} of {len(corrected.runs)}"
    off = study.off_nominal()
    closest = min((d for d in study.deviations if d.until is not None), key=lambda d: (abs(d.percent), d.until))
    steepest = max(
        (a for a in study.inside if a.law == regularised.law and not math.isclose(a.M, NOMINAL.M)),
        key=lambda a: a.descent.rise,
    )
    claims = published.CLAIMS
    return [
        Judgement(
            claims["adaptive"],
            f"regularised: rms error at most {worst.error_rms:.1e} rad (M = {worst.M:.3f} kg, mu = {worst.mu:.4f}); "
            f"corrected, unregularised it fails on {corrected.failures} of {len(corrected.runs)} plants, on "
            f"{over_choices} over what the paper leaves open",
            corrected.failures == 0,
        ),
        Judgement(
            claims["finite_time"],
            f"regularised, off the nominal plant: the largest angle error of a cycle is {_span(off, 'angle_error', 1)} "
            f"rad in the first, {_span(off, 'angle_error', LONG)} in the {LONG}th and "
            f"{_span(off, 'angle_error', LONGEST)} in the {LONGEST}th. Theorem 1 itself speaks of no finite time",
            converged(off, "angle_error"),
        ),
        Judgement(
            claims["rate"],
            f"the reference is periodic: only the velocity's error can converge. {_course(study, 'rate_error')}",
            converged(off, "rate_error"),
        ),
        Judgement(claims["sliding"], _course(study, "sliding"), converged(off, "sliding")),
        Judgement(
            claims["stable"],
            f"corrected, unregularised: {over_choices} plants lose contact within five cycles over what the paper "
            f"leaves open, {min(saturated)} to {max(saturated)} with a motor of {TORQUE_LIMIT:g} N m. x_d keeps the "
            "nominal plant's pace, so that x - x_d grows by every cycle, and T_n with it: with "
            f"{closest.parameter} off by {closest.percent:+g} % contact is lost after {closest.until:.0f} s",
            max(free) == 0,
        ),
        Judgement(
            claims["bounded"],
            f"corrected, unregularised, motor of {TORQUE_LIMIT:g} N m: eta reaches {highest.eta:.0e}, its numerical "
            f"bound, and |T_n| {limited.worst('auxiliary_torque').auxiliary_torque:.0e} N m. Nor is u continuous: "
            "where delta_theta changes sign (39c) jumps by 2 |delta_x| (|eta| + K2). Regularised, the bounds are "
            "imposed",
            highest.eta < 0.99 * UNREGULARISED.eta_bound,
        ),
        Judgement(
            claims["convergence"],
            "corrected, unregularised: no, it loses contact. Regularised, off the nominal plant: the angle error falls "
            f"{_falls(off, 'angle_error', LONG)} times in {LONG} cycles, {_falls(off, 'angle_error', LONGEST)} times "
            f"in {LONGEST}; it stays bounded and does not vanish",
            corrected.failures == 0 and converged(off, "angle_error"),
        ),
        Judgement(
            claims["lyapunov"],
            f"regularised: it rises in {100.0 * steepest.descent.rising:.0f} % of the time, by "
            f"{steepest.descent.rise:.2f} in all (M = {steepest.M:.2f} kg, mu = {steepest.mu:.3f})",
            all(adaptation.descent.rise == 0.0 for adaptation in study.inside),
        ),
    ]


def _course(study: AdaptiveStudy, quantity: str) -> str:
    """How the largest of one of the errors goes over the cycles, at the slowest and the fastest rate."""
    slow, fast = RATES[0], RATES[-1]
    return (
        f"Regularised, the largest of a cycle: on the nominal plant {study.on_nominal(slow).at(quantity, 1):.1e} rad/s "
        f"at {slow // 1000} kHz and {study.on_nominal(fast).at(quantity, 1):.1e} at {fast // 1000} kHz, which is the "
        f"torque's hold. Off it, {_span(study.off_nominal(slow), quantity, 1)} and "
        f"{_span(study.off_nominal(fast), quantity, 1)}, which hardly is; in the {LONG}th cycle "
        f"{_span(study.off_nominal(slow), quantity, LONG)} and {_span(study.off_nominal(fast), quantity, LONG)}, in "
        f"the {LONGEST}th (at {slow // 1000} kHz) {_span(study.off_nominal(slow), quantity, LONGEST)}: it falls, and "
        "does not vanish"
    )


def _span(runs: Sequence[LongRun], quantity: str, cycle: int) -> str:
    """Smallest and largest of an error in a cycle."""
    values = [run.at(quantity, cycle) for run in runs]
    return f"{min(values):.1e} to {max(values):.1e}"


def _falls(runs: Sequence[LongRun], quantity: str, cycle: int) -> str:
    """How many times smaller than in the first cycle an error is: the least and the most."""
    falls = [run.at(quantity, 1) / run.at(quantity, cycle) for run in runs]
    return f"{min(falls):.1f} to {max(falls):.1f}"
