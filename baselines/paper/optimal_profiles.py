"""The paper's 'optimal trajectory' made true: the seven-phase profile (9) whose parameters are optimal, not selected.

Free are the seven times, V1 and P2 (P3 closes the cycle) and, where a problem says so, the angle at the start. The aim
is the mean speed under exact tracking, subject to a torque limit and Principles 1 to 4. Their bounds are not published,
so the published profile's own largest angle, velocity and acceleration bound the others, which makes it one of the
candidates. Principle 4 comes in the readings of `STANDSTILLS`.

What one search finds serves all others. The speeds are lower bounds of the optimum; how far a search can stay behind is
shown by further ones with other seeds (`Spread`), which the file holds beside the solutions.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.paper.profile_settings import DATA, GENERATIONS, PROG, SEED
from capsule_gym.command_line import parse, refuse


@dataclass(frozen=True)
class Options:
    """Optimises the paper's profile (9) for speed, under exact tracking, Principles 1 to 4 and a torque limit.

    Goes on from what the file holds; Ctrl-C keeps the problems solved so far. A quarter of an hour on one core for
    all of them, and half of one for the searches with other seeds that show how far a search can stay behind.

    Examples:
      python -m baselines.paper.optimal_profiles            solve what the file lacks
      python -m baselines.paper.optimal_profiles --check    assess what it holds again, write nothing
      python -m baselines.paper.optimal_profiles --again --seed 1 --json other.json
    """

    json: Path = DATA
    """Where the results are, and go."""
    seed: int = SEED
    """Of the searches."""
    generations: int = GENERATIONS
    """Of each search."""
    again: bool = False
    """Solve again what the file holds."""
    check: bool = False
    """Assess what the file holds, search nothing; the exit status says whether it holds what it claims."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    # After the command line is known to be right: the help needs none of it.
    from baselines.paper.profile_records import Found, check, format_row, format_spread, load, repeat, solve

    found = Found(options.seed, options.generations, ())
    if options.json.exists() and (options.check or not options.again):
        found = load(options.json)
    if options.check:
        wrong = check(found.solutions)
        print(*(format_row(each) for each in found.solutions), *wrong, sep="\n")
        return 1 if wrong or not found.solutions else 0
    if (found.seed, found.generations) != (options.seed, options.generations):
        refuse(PROG, f"{options.json} holds searches with another seed or number of generations; --again replaces them")
    try:
        found = solve(found, options.json)
        found = repeat(found, options.json)
    except KeyboardInterrupt:
        print(f"interrupted; {options.json} keeps what was found, call again to go on", file=sys.stderr)
        return 130
    print("\nThe best of all searches for each problem:", *(format_row(each) for each in found.solutions), sep="\n")
    print("\nFurther searches, each alone:", *(format_spread(found, each) for each in found.spreads), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
