"""Solves the direct-torque task by dynamic programming: `python -m baselines.dynamic_programming`.

The problems: every plant of `baselines.archive.PLANTS`; the nominal plant with a margin of normal force, with weights
on the energy, and with shorter control intervals. Results are written after every problem.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from baselines.dynamic_programming import FOLDER
from capsule_gym.command_line import parse
from capsule_gym.task import CONTROL_DT

if TYPE_CHECKING:
    from baselines.dynamic_programming.archive import Archive
    from baselines.dynamic_programming.problem import Problem

PROG = "python -m baselines.dynamic_programming"
# s
CONTROL_INTERVALS = (0.01, 0.005)
# cm/J
ENERGY_WEIGHTS = (0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
# N: by so much the weight of the platform may be smaller.
MARGIN = 1.6


@dataclass(frozen=True)
class Args:
    """Computes policies by dynamic programming. Goes on from what is known; Ctrl-C keeps what has been found.

    Examples:
      python -m baselines.dynamic_programming                      all that is missing
      python -m baselines.dynamic_programming --report             print the tables of what is on file
      python -m baselines.dynamic_programming --check              repeat every trajectory and write nothing
      python -m baselines.dynamic_programming --folder new         compute everything again
    """

    check: bool = False
    """Repeat every trajectory on file, write nothing; the exit status is 1 if a speed differs in the last bit."""
    report: bool = False
    """Only print the tables of what is on file."""
    folder: Path = FOLDER
    """Of the archive."""


def problems() -> list[Problem]:
    """All problems."""
    from baselines.archive import PLANTS
    from baselines.dynamic_programming.problem import Problem

    return [
        *(Problem(M=M, mu=mu) for M, mu in PLANTS),
        Problem(margin=MARGIN),
        *(Problem(energy_weight=weight) for weight in ENERGY_WEIGHTS),
        *(Problem(control_dt=control_dt) for control_dt in CONTROL_INTERVALS),
    ]


def solve_all(wanted: Sequence[Problem], archive: Archive) -> Iterator[None]:
    """Solves problems as it is iterated, and adds them to the archive."""
    from baselines.dynamic_programming.problem import Problem
    from baselines.dynamic_programming.refinement import GRIDS, solve_on_grids

    for n, problem in enumerate(wanted):
        name = (
            f"{n + 1}/{len(wanted)} M={problem.M:g}, mu={problem.mu:g}, interval {1e3 * problem.control_dt:g} ms, "
            f"{problem.energy_weight:g} cm/J, margin {problem.margin:g} N"
        )
        count = 3 if problem.control_dt < CONTROL_DT else 4 if problem == Problem() else 2
        began = perf_counter()
        print(f"{name} ..", flush=True)
        results = solve_on_grids(problem, GRIDS[:count])
        # The policies' values: those of the speed problems with the default control interval.
        values = problem.energy_weight == 0.0 and problem.control_dt == CONTROL_DT
        result = archive.add(problem, results, perf_counter() - began, values=values)
        print(f"{name}: {result.mean_speed:.2f} cm/s over 33 s, {result.seconds:.0f} s", flush=True)
        yield


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported once the command line is known to be right: the help needs none of it.
    from baselines.archive import run_search
    from baselines.dynamic_programming.archive import key_of, load_archive
    from baselines.dynamic_programming.report import report

    archive = load_archive(args.folder)
    if args.check:
        stale = archive.check()
        print(*stale, f"{len(archive.results)} trajectories repeated: {len(stale)} differ", sep="\n")
        return int(bool(stale))
    if args.report:
        print(report(archive))
        return 0
    missing = [problem for problem in problems() if key_of(problem) not in archive.results]
    interrupted = run_search(solve_all(missing, archive), lambda: archive.save(args.folder))
    print(f"{len(archive.results)} problems on file in {args.folder}")
    return 130 if interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
