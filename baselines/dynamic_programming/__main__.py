"""Solves the direct-torque task by dynamic programming: `python -m baselines.dynamic_programming`.

Results are written after every problem of `baselines.dynamic_programming.problem.PROBLEMS`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from baselines.dynamic_programming import FOLDER
from capsule_gym.command_line import parse, refuse

PROG = "python -m baselines.dynamic_programming"


@dataclass(frozen=True)
class Args:
    """Computes the results of dynamic programming that the archive lacks. Ctrl-C keeps finished results.

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
    """Folder of the archive."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing, since `--help` does not need these modules.
    from baselines.archive import run_search
    from baselines.dynamic_programming.archive import load_archive, set_plants, solve_plants
    from baselines.dynamic_programming.problem import PROBLEMS

    try:
        archive = load_archive(args.folder)
    except ValueError as error:
        refuse(PROG, str(error))
    if args.check:
        stale = archive.check()
        count = len(archive.results) + len(archive.plant_speeds)
        print(*stale, f"{count} trajectories repeated: {len(stale)} differ", sep="\n")
        return int(bool(stale))
    missing = [problem for problem in PROBLEMS if problem.key not in archive.results]
    plants = [plant for plant in set_plants() if plant not in archive.plant_speeds]
    if args.report:
        if lacking := len(missing) + len(plants):
            refuse(PROG, f"--report needs all problems and plants on file, and {args.folder} lacks {lacking}")
        from baselines.dynamic_programming.tables import report

        print(report(archive))
        return 0
    steps = chain(archive.solve(missing), solve_plants(archive, plants))
    interrupted = run_search(steps, lambda: archive.save(args.folder))
    print(f"{len(archive.results)} problems and {len(archive.plant_speeds)} plants of sets on file in {args.folder}")
    return 130 if interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
