"""Each published number beside ours, with a verdict, and for each that differs the reason."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from baselines.laws.adaptive import nominal_estimates
from baselines.paper import published
from baselines.paper.proofs import LargestRate, PeakTorque
from baselines.paper.published import Claim, Number
from baselines.paper.reproduction import Reproduction
from baselines.tables import printed_above, printed_below
from capsule_gym import Capsule

# Reading a curve off a figure, and the digits of print, are no better.
AGREEMENT = 0.02
# Travel backwards over forwards that still counts as suppressed.
SUPPRESSED = 0.1

CALIBRATED, PREDICTED, CONSTANT = "calibrated", "predicted", "constant"


@dataclass(frozen=True)
class Row:
    """A published number beside ours.

    Attributes:
        run: what it belongs to.
        number: the published one.
        found: ours, in the same unit.
        kind: "calibrated" where a free parameter was set to meet it, "predicted" where nothing was, "constant" where it
            only restates the plant.
        reason: why they differ; empty where they do not.
        note: what is worth saying although they agree.
    """

    run: str
    number: Number
    found: float
    kind: str
    reason: str = ""
    note: str = ""

    @property
    def difference(self) -> float:
        """Relative difference, found against published."""
        return self.found / self.number.value - 1.0

    @property
    def reproduced(self) -> bool:
        """Whether they agree."""
        return abs(self.difference) <= AGREEMENT


@dataclass(frozen=True)
class Judgement:
    """A published claim beside what was found.

    Attributes:
        claim: the statement.
        found: what was found.
        reproduced: whether it holds here.
    """

    claim: Claim
    found: str
    reproduced: bool


def compare_numbers(result: Reproduction, peaks: list[PeakTorque], rates: list[LargestRate]) -> list[Row]:
    """The published numbers of both profiles beside ours."""
    rows = []
    for name, numbers, peak, rate in zip(
        ("proposed", "EPC"), (published.PROPOSED, published.EPC), peaks, rates, strict=True
    ):
        run = result.run(name)
        rows += [
            Row(name, numbers["peak_velocity"], run.peak_velocity, CALIBRATED),
            Row(name, numbers["swing"], run.largest_angle_deg, CALIBRATED),
            Row(name, numbers["mean_speed"], run.mean_speed, PREDICTED, _why_speed(result, name)),
            Row(name, numbers["peak_torque"], run.peak_torque, PREDICTED, _why_torque(peak, rate)),
        ]
    swings = result.run("EPC").largest_angle_deg - result.run("proposed").largest_angle_deg
    rows.append(Row("both", published.SWING_DIFFERENCE, swings, CALIBRATED))
    return rows


def _why_speed(result: Reproduction, name: str) -> str:
    """Why the published mean speed does not come out."""
    run, other = result.run(name), result.run(name, "paper")
    fits = {fit.profile: fit for fit in result.frictions}
    study = next(study for study in result.steps if study.profile == name)
    spread = float(np.ptp(study.speed)) / run.mean_speed
    own, rival = fits[name], fits["EPC" if name == "proposed" else "proposed"]
    friction = ", ".join(f"{mu:.3f}" for mu in own.mu)
    theirs = ", ".join(f"{mu:.3f}" for mu in rival.mu)
    return (
        f"With the pendulum on its profile the speed follows from M, m, l, g and mu alone: no gain enters. The paper's "
        f"normal force changes it by {100.0 * (other.mean_speed / run.mean_speed - 1.0):+.1f} %, steps from 0.1 to 10 "
        f"ms by {100.0 * spread:.1f} %. {own.speed:g} cm/s would take mu = {friction}; {rival.profile}'s "
        f"{rival.speed:g} would take {theirs}, and the paper states 0.01 for both: no mu fits both."
    )


def _why_torque(peak: PeakTorque, rate: LargestRate) -> str:
    """Why the published torque cannot come out."""
    return (
        f"Impossible beside the published velocity. Proof 1: at the peak of {peak.velocity:g} rad/s the motor gives at "
        f"least {printed_below(peak.bound, 3)} N m. Proof 2: with {rate.torque:g} N m theta' stays below "
        f"{printed_above(rate.bound, 3)} rad/s; to reach {rate.published:g} takes at least "
        f"{printed_below(rate.torque_needed, 3)} N m."
    )


def compare_constants() -> list[Row]:
    """The numbers that restate the plant's constants."""
    capsule = Capsule()
    reasons = {
        "alpha_theta_1": "m l^2 = 0.138 x 0.09 = 0.01242: the digits of the print are transposed.",
    }
    notes = {
        "alpha_theta_5": "m g l = 0.40613 with g = 9.81; the print has g = 9.789. The law starts from 0.40613.",
    }
    rows = [Row("plant", published.NATURAL_FREQUENCY, math.sqrt(capsule.g / capsule.l), CONSTANT)]
    for (key, number), value in zip(published.BASE_PARAMETERS.items(), nominal_estimates(capsule.plant()), strict=True):
        rows.append(Row("plant", number, value, CONSTANT, reasons.get(key, ""), notes.get(key, "")))
    return rows


def judge_claims(result: Reproduction) -> list[Judgement]:
    """The claims of both profiles beside what was found."""
    proposed, epc = result.run("proposed"), result.run("EPC")
    ratio = next(fit for fit in result.frictions if fit.profile == "proposed").ratio
    claims = published.CLAIMS
    return [
        Judgement(
            claims["faster"],
            f"{proposed.mean_speed:.3f} against {epc.mean_speed:.3f} cm/s: EPC is faster, here and for every mu in "
            f"[0.003, 1] at which it moves (ratio {ratio[0]:.2f} to {ratio[1]:.2f})",
            proposed.mean_speed > epc.mean_speed,
        ),
        Judgement(
            claims["torque"],
            f"{proposed.peak_torque:.3f} against {epc.peak_torque:.3f} N m",
            proposed.peak_torque < epc.peak_torque,
        ),
        Judgement(
            claims["energy"],
            f"cost of transport {proposed.cost_of_transport:.2f} against {epc.cost_of_transport:.2f}, energy per cycle "
            f"{proposed.energy:.2f} against {epc.energy:.2f} J",
            proposed.cost_of_transport < epc.cost_of_transport,
        ),
        Judgement(
            claims["backward"],
            f"{proposed.backward:.2f} cm back per cycle, {100.0 * proposed.backward_ratio:.1f} % of the way forwards; "
            f"EPC, {epc.backward:.2f} cm and {100.0 * epc.backward_ratio:.1f} %, slides back less",
            proposed.backward_ratio < SUPPRESSED,
        ),
    ]
