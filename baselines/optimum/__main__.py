"""Computes the optima and writes them to `data/`: `python -m baselines.optimum`.

The problems: every plant of the grid of `baselines.gaits.archive`, for the speeds that policies are measured by; the
nominal plant on ever finer grids; with the torque held shorter; with the energy weighed; and with normal force to
spare. What is known is kept, unless `--again` says otherwise, and written after every problem and on Ctrl-C.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.optimum import FOLDER
from capsule_gym.command_line import parse, refuse

PROG = "python -m baselines.optimum"


@dataclass(frozen=True)
class Options:
    """Computes the optima by dynamic programming. Goes on from what is known; Ctrl-C keeps what has been found.

    Examples:
      python -m baselines.optimum                      all that is missing
      python -m baselines.optimum --report             print the tables of what is on file
      python -m baselines.optimum --check              repeat every motion on file and write nothing
      python -m baselines.optimum --parts plants --again
    """

    check: bool = False
    """Repeat every motion on file, write nothing; the exit status says whether all speeds are met, to the last bit."""
    report: bool = False
    """Only print the tables of what is on file."""
    parts: tuple[str, ...] = ()
    """Problems to solve, of plants, margins, weights and holds; all where none is given."""
    again: bool = False
    """Solve again what is known."""
    folder: Path = FOLDER
    """Of the files."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    # After the command line is known to be right: the help needs none of it.
    from baselines.optimum.parts import PARTS, check, describe, solve
    from baselines.optimum.records import Archive, key_of
    from baselines.optimum.report import report

    if not set(options.parts) <= set(PARTS):
        refuse(PROG, f"--parts must be some of {', '.join(PARTS)}, got {' '.join(options.parts)}")
    archive = Archive(options.folder)
    if options.check:
        stale = check(archive)
        print(*stale, sep="\n")
        print(f"{len(archive.records)} motions repeated: {len(stale)} differ")
        return int(bool(stale))
    if options.report:
        print(report(archive))
        return 0
    problems = [problem for part in options.parts or PARTS for problem in PARTS[part]]
    missing = [problem for problem in problems if options.again or key_of(problem) not in archive.records]
    for n, problem in enumerate(missing):
        name = f"{n + 1}/{len(missing)} {describe(problem)}"
        try:
            solve(problem, archive, name)
        except KeyboardInterrupt:
            print(f"\n{len(archive.records)} problems are on file; call again to go on")
            return 130
    print(f"{len(archive.records)} problems on file in {options.folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
