"""Solves the direct-torque task by dynamic programming: `python -m baselines.dynamic_programming`.

Results are written after every problem of `baselines.dynamic_programming.problem.PROBLEMS`.
"""

import sys
from itertools import chain
from pathlib import Path

from baselines.dynamic_programming.archive import (
    extrapolated,
    load_archive,
    set_plants,
    solve_plants,
)
from baselines.dynamic_programming.problem import PROBLEMS
from capsule_gym.command_line import command
from capsule_gym.evaluation.optimum import FOLDER


@command("python -m baselines.dynamic_programming", OSError, ValueError)
def main(check: bool = False, report: bool = False, folder: Path = FOLDER) -> int:
    """Computes the results of dynamic programming that the archive lacks.

    Ctrl-C keeps finished results.

    Examples:
      python -m baselines.dynamic_programming                 all that is missing
      python -m baselines.dynamic_programming --report        print what is on file
      python -m baselines.dynamic_programming --check         repeat every trajectory, write nothing
      python -m baselines.dynamic_programming --folder new    compute everything again

    Args:
        check: Repeat every trajectory on file, write nothing; the exit status is 1 if a speed
            differs in the last bit.
        report: Only print the results on file, with the limit of their gains on ever finer grids,
            cm/s.
        folder: Folder of the archive.
    """
    archive = load_archive(folder)
    if (check or report) and not archive.results:
        option = "--check" if check else "--report"
        raise ValueError(f"{option} needs results on file, and {folder} has none")
    if check:
        stale = archive.check()
        count = len(archive.results) + len(archive.plant_speeds)
        print(*stale, f"{count} trajectories repeated: {len(stale)} differ", sep="\n")
        return int(bool(stale))
    if report:
        # Needs an extra of the package.
        from baselines.tables import fields_table

        results = archive.results.values()
        rows = [{**result.content(), "limit": extrapolated(result)} for result in results]
        print(fields_table(rows))
        return 0
    missing = [problem for problem in PROBLEMS if problem.key not in archive.results]
    plants = [plant for plant in set_plants() if plant not in archive.plant_speeds]
    # Before the computation, which takes hours.
    folder.mkdir(parents=True, exist_ok=True)
    status = 0
    try:
        for _ in chain(archive.solve(missing), solve_plants(archive, plants)):
            archive.save(folder)
    except KeyboardInterrupt:
        archive.save(folder)
        status = 130
    problems = len(archive.results)
    print(f"{problems} problems and {len(archive.plant_speeds)} plants of sets on file in {folder}")
    return status


if __name__ == "__main__":
    sys.exit(main())
