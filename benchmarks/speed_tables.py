"""The tables of `python -m benchmarks.throughput`, with what must be known to read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from baselines.tables import markdown_table, text_table
from benchmarks import accuracy, contenders, cost, creep
from benchmarks.timing import Contender, Rate
from capsule_gym import task
from capsule_gym.parameters import DIRECT_PHYSICS_DT

Rows = list[list[str]]


@dataclass(frozen=True)
class Measurements:
    """What one run has measured.

    Attributes:
        contenders: all that were measured.
        rates: theirs, by name.
        points: errors and costs.
        creeps: by model, one per load.
        trajectories: behind each error.
    """

    contenders: Sequence[Contender]
    rates: Mapping[str, Rate]
    points: Sequence[cost.Point]
    creeps: Mapping[str, Sequence[creep.Creep]]
    trajectories: int

    @property
    def claims(self) -> list[cost.Claim]:
        """The comparison with MuJoCo at the default step; empty where it was not measured."""
        return cost.claims(self.rates, self.points)

    def to_dict(self) -> dict[str, Any]:
        """The numbers as plain types."""
        return {
            "rates": [
                {
                    "name": contender.name,
                    "label": contender.label,
                    "environments": contender.environments,
                    "threads": contender.threads,
                    "substeps": contender.substeps,
                    "peer": contender.peer,
                    **asdict(self.rates[contender.name]),
                }
                for contender in self.contenders
            ],
            "cases": [case._asdict() for case in cost.CASES],
            "accuracy_against_cost": [asdict(point) for point in self.points],
            "creep": {name: [asdict(entry) for entry in entries] for name, entries in self.creeps.items()},
            "claims": [{**asdict(claim), "ratio": claim.ratio, "holds": claim.holds} for claim in self.claims],
        }


@dataclass(frozen=True)
class Section:
    """A table with its title and what must be known to read it."""

    title: str
    rows: Rows
    notes: list[str]


def rate_rows(measured: Sequence[Contender], rates: Mapping[str, Rate]) -> Rows:
    """The table of rates; a ratio only where its peer was measured."""
    rows = [["", "envs", "threads", "substeps", "env-steps/s", "IQR", "substeps/s", "us per env-step", "ratio", "to"]]
    labels = {contender.name: contender.label for contender in measured}
    for contender in measured:
        rate = rates[contender.name]
        peer = rates.get(contender.peer) if contender.peer else None
        rows.append(
            [
                contender.label,
                f"{contender.environments:,}",
                str(contender.threads),
                str(contender.substeps),
                f"{rate.median:,.0f}",
                f"{rate.spread:.0%}",
                f"{rate.median * contender.substeps:,.0f}",
                f"{1e6 / rate.median:.3g}",
                f"{rate.median / peer.median:.3g}" if peer else "",
                labels[contender.peer] if contender.peer and peer else "",
            ]
        )
    return rows


def cost_rows(points: Sequence[cost.Point]) -> Rows:
    """The table of accuracy against cost."""
    rows = [["", "step", "us per simulated s", "IQR", *(f"error, {case}" for case in cost.CASES)]]
    for point in points:
        errors = (f"{error:.1e}" for error in point.errors)
        rows.append(
            [point.series, f"{1e3 * point.physics_dt:g} ms", f"{point.cost:.3g}", f"{point.spread:.0%}", *errors]
        )
    return rows


def creep_rows(results: Mapping[str, Sequence[creep.Creep]]) -> Rows:
    """The table of creep velocities."""
    driven = (f"driven, {load:.0%}" for load in creep.LOADS)
    steady = (f"steady, {load:.0%}" for load in creep.LOADS)
    rows = [["", *driven, *steady]]
    for name, creeps in results.items():
        cells = [f"{found.median:.1e} ({found.largest:.1e})" for found in creeps]
        cells += ["-" if found.steady is None else f"{found.steady:.1e}" for found in creeps]
        rows.append([name, *cells])
    return rows


def claim_rows(found: Sequence[cost.Claim]) -> Rows:
    """Whether ours is as many times as fast as claimed without a larger error."""
    verdict = f"{cost.CLAIMED_RATIO:g} times, error no larger"
    rows = [["against", "threads", "ours, env-steps/s", "theirs", "ratio", "our error", "their error", verdict]]
    for claim in found:
        rows.append(
            [
                claim.peer,
                str(claim.threads),
                f"{claim.ours:,.0f}",
                f"{claim.theirs:,.0f}",
                f"{claim.ratio:.3g}",
                " / ".join(f"{error:.1e}" for error in claim.our_errors),
                " / ".join(f"{error:.1e}" for error in claim.their_errors),
                "yes" if claim.holds else "no",
            ]
        )
    return rows


def reset_note(measured: Sequence[Contender], rates: Mapping[str, Rate]) -> str:
    """What the resets of whole episodes add to the largest batch of ours."""
    own = [c for c in measured if c.label == contenders.DIRECT_BATCH and c.threads == 1]
    largest = max(own, key=lambda contender: contender.environments)
    rate = rates[largest.name]
    assert rate.reset_seconds is not None
    share = rate.reset_seconds / largest.environments / (task.EPISODE_STEPS / rate.median)
    return (
        f"Batches of ours never truncate here: resetting all of {largest.environments:,} environments takes "
        f"{rate.reset_seconds:.2g} s, which adds {share:.1%} to the time of an episode of {task.EPISODE_STEPS} steps."
    )


def _rate_section(measured: Sequence[Contender], rates: Mapping[str, Rate]) -> Section:
    return Section(
        "Environment steps per second",
        rate_rows(measured, rates),
        [
            f"A step of ours and of MuJoCo's capsule is {1e3 * task.CONTROL_DT:g} ms; direct torque is uniform "
            f"within ±{contenders.ACTION_SCALE * task.TORQUE_LIMIT:g} N m, the law is baselines:adaptive. Ours "
            "computes observation, reward and info too, MuJoCo's batch (mujoco.rollout) the physics alone. Ratios "
            "of batches are to its batch at the same step and number of threads.",
            reset_note(measured, rates),
        ],
    )


def _cost_section(points: Sequence[cost.Point], trajectories: int) -> Section:
    return Section(
        "Accuracy against cost",
        cost_rows(points),
        [
            f"Largest error in any state after {accuracy.SECONDS:g} s of random torque, {trajectories} "
            f"trajectories a case, against DOP853; computing of a batch of {contenders.PEER_BATCH:,} on one "
            f"thread, per environment. 'stiff': the hardest constraints that MuJoCo allows at the step.",
        ],
    )


def _creep_section(creeps: Mapping[str, Sequence[creep.Creep]]) -> Section:
    return Section(
        "Creep below the friction limit, m/s",
        creep_rows(creeps),
        [
            f"Driven: median (largest) |x'| over {creep.SECONDS:g} s while the pendulum pushes the platform with "
            "that share of its friction limit mu N, in turns forwards and backwards. Steady: mean x' under a "
            "constant outer force of that share, which capsule_gym does not know. Step "
            f"{1e3 * DIRECT_PHYSICS_DT:g} ms.",
        ],
    )


def _claim_section(found: Sequence[cost.Claim]) -> Section:
    cases = " / ".join(map(str, cost.CASES))
    return Section(
        "Against MuJoCo at the default step",
        claim_rows(found),
        [f"Step {1e3 * DIRECT_PHYSICS_DT:g} ms, {contenders.PEER_BATCH:,} environments; errors: {cases}."],
    )


def sections(found: Measurements) -> list[Section]:
    """All tables with their notes; the claim's only where MuJoCo was measured."""
    listed = [
        _rate_section(found.contenders, found.rates),
        _cost_section(found.points, found.trajectories),
        _creep_section(found.creeps),
    ]
    return [*listed, _claim_section(found.claims)] if found.claims else listed


def as_text(listed: Sequence[Section], notes: Sequence[str]) -> str:
    """The tables for the terminal."""
    parts = [
        part for section in listed for part in (section.title.upper(), text_table(section.rows), *section.notes, "")
    ]
    return "\n".join([*parts, *notes])


def as_markdown(listed: Sequence[Section], notes: Sequence[str]) -> list[str]:
    """The lines of the page for the documentation."""
    lines = []
    for section in listed:
        lines += [f"### {section.title}", "", markdown_table(section.rows), ""]
        lines += [line for note in section.notes for line in (note, "")]
    return [*lines, *(line for note in notes for line in (note, ""))][:-1]
