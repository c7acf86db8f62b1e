"""Speed of the environment beside its peers, and what accuracy costs: `python -m benchmarks.throughput`.

Three tables from one run: environment steps per second, the error of a simulated trajectory over the computing that it
takes, and the creep of a platform that friction should hold. Peers that need a package more come with the extra
`bench`. Nothing else should run on the machine meanwhile.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from agents.evaluation.tables import markdown_table, text_table
from benchmarks import accuracy, contenders, cost, creep, speed_figure
from benchmarks.timing import Contender, Rate, available_cores, describe, machine, measure, present
from capsule_gym import task
from capsule_gym.files import to_json, write_atomically
from capsule_gym.options import DIRECT_PHYSICS_DT

TURNS, QUICK_TURNS = 9, 3
TURN_SECONDS = 0.2
# MuJoCo's finest steps take seconds each, and the costs span three decades: fewer turns tell them apart.
COST_TURNS_SHARE = 0.5
TRAJECTORIES, QUICK_TRAJECTORIES = 16, 4
COMMENT = "<!-- Written by python -m benchmarks.throughput: do not edit. -->"
Rows = list[list[str]]


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


def sections(
    measured: Sequence[Contender],
    rates: Mapping[str, Rate],
    points: Sequence[cost.Point],
    creeps: Mapping[str, Sequence[creep.Creep]],
    trajectories: int,
) -> list[Section]:
    """All tables with their notes."""
    cases = " / ".join(map(str, cost.CASES))
    found = cost.claims(rates, points)
    listed = [
        Section(
            "Environment steps per second",
            rate_rows(measured, rates),
            [
                f"A step of ours and of MuJoCo's capsule is {1e3 * task.CONTROL_DT:g} ms; direct torque is uniform "
                f"within ±{contenders.ACTION_SCALE * task.TORQUE_LIMIT:g} N m, the law is baselines:adaptive. Ours "
                "computes observation, reward and info too, MuJoCo's batch (mujoco.rollout) the physics alone. Ratios "
                "of batches are to its batch at the same step and number of threads.",
                reset_note(measured, rates),
            ],
        ),
        Section(
            "Accuracy against cost",
            cost_rows(points),
            [
                f"Largest error in any state after {accuracy.SECONDS:g} s of random torque, {trajectories} "
                f"trajectories a case, against DOP853; computing of a batch of {contenders.PEER_BATCH:,} on one "
                f"thread, per environment. 'stiff': the hardest constraints that MuJoCo allows at the step.",
            ],
        ),
        Section(
            "Creep below the friction limit, m/s",
            creep_rows(creeps),
            [
                f"Driven: median (largest) |x'| over {creep.SECONDS:g} s while the pendulum pushes the platform with "
                "that share of its friction limit mu N, in turns forwards and backwards. Steady: mean x' under a "
                "constant outer force of that share, which capsule_gym does not know. Step "
                f"{1e3 * DIRECT_PHYSICS_DT:g} ms.",
            ],
        ),
    ]
    if found:
        note = f"Step {1e3 * DIRECT_PHYSICS_DT:g} ms, {contenders.PEER_BATCH:,} environments; errors: {cases}."
        listed.append(Section("Against MuJoCo at the default step", claim_rows(found), [note]))
    return listed


def as_text(listed: Sequence[Section], notes: Sequence[str]) -> str:
    """The tables for the terminal."""
    parts = [
        part for section in listed for part in (section.title.upper(), text_table(section.rows), *section.notes, "")
    ]
    return "\n".join([*parts, *notes])


def as_markdown(listed: Sequence[Section], notes: Sequence[str]) -> str:
    """The tables for the documentation."""
    lines = [COMMENT, ""]
    for section in listed:
        lines += [f"### {section.title}", "", *markdown_table(section.rows), ""]
        lines += [line for note in section.notes for line in (note, "")]
    return "\n".join([*lines, *(line for note in notes for line in (note, ""))])


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.throughput", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--turns", type=int, metavar="N", help=f"turns of every contender (default: {TURNS})")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_TURNS} turns, no batch of {contenders.LARGE:,}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to this new file")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables to this file")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw the chart into this file")
    options = parser.parse_args(arguments)
    if options.turns is None:
        options.turns = QUICK_TURNS if options.quick else TURNS
    if options.turns < 1:
        parser.error(f"--turns must be at least 1, got {options.turns}")
    if options.json is not None and options.json.exists():
        parser.error(f"--json must name a new file, got {str(options.json)!r}")
    if options.figure is not None and options.figure.suffix != ".png":
        parser.error(f"--figure must name a .png file, got {str(options.figure)!r}")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(arguments)
    start = time.perf_counter()
    found = machine()
    everything = [*contenders.ours(large=not options.quick), *contenders.peers()]
    measured, left_out = present(everything, available_cores())
    for line in left_out:
        print(line, file=sys.stderr, flush=True)
    trajectories = QUICK_TRAJECTORIES if options.quick else TRAJECTORIES
    with_mujoco = any("mujoco" in contender.packages for contender in measured)
    rates = measure(measured, options.turns, TURN_SECONDS, "rates")
    cost_turns = math.ceil(COST_TURNS_SHARE * options.turns)
    points = cost.measure_points(with_mujoco, cost_turns, TURN_SECONDS, trajectories, options.quick)
    creeps = creep.table(DIRECT_PHYSICS_DT, with_mujoco)
    listed = sections(measured, rates, points, creeps, trajectories)
    turns = f"medians of {options.turns} turns ({cost_turns} for the costs), IQR: interquartile range over it"
    notes = [f"{describe(found)}; {turns}.", *left_out]
    print(as_text(listed, notes))
    if options.json is not None:
        content: dict[str, Any] = {
            "machine": found,
            "turns": options.turns,
            "cost_turns": cost_turns,
            "turn_seconds": TURN_SECONDS,
            "seconds": time.perf_counter() - start,
            "left_out": left_out,
            "rates": [
                {
                    "name": contender.name,
                    "label": contender.label,
                    "environments": contender.environments,
                    "threads": contender.threads,
                    "substeps": contender.substeps,
                    "peer": contender.peer,
                    **asdict(rates[contender.name]),
                }
                for contender in measured
            ],
            "cases": [case._asdict() for case in cost.CASES],
            "accuracy_against_cost": [asdict(point) for point in points],
            "creep": {name: [asdict(entry) for entry in entries] for name, entries in creeps.items()},
            "claims": [
                {**asdict(claim), "ratio": claim.ratio, "holds": claim.holds} for claim in cost.claims(rates, points)
            ],
        }
        write_atomically(options.json, to_json(content))
    if options.markdown is not None:
        write_atomically(options.markdown, as_markdown(listed, notes))
    if options.figure is not None:
        speed_figure.save(options.figure, measured, rates, points, notes[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
