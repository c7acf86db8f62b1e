"""Optimises the parameters of the paper's seven-phase profile (9): `python -m baselines.paper.optimal_profiles`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capsule_gym.command_line import parse, refuse

PROG = "python -m baselines.paper.optimal_profiles"
DATA = Path(__file__).with_name("optimal_profiles.json")
GENERATIONS = 200
SEED = 0


@dataclass(frozen=True)
class Args:
    """Optimises the paper's profile (9) for speed, under exact tracking, Principles 1 to 4 and a torque limit.

    Resumes from what the file holds; Ctrl-C keeps the problems solved so far. About an hour on one core for all
    problems and two for the repeated searches, which show how much a single search may miss.

    Examples:
      python -m baselines.paper.optimal_profiles            solve what the file lacks
      python -m baselines.paper.optimal_profiles --check    assess its solutions again, write nothing
      python -m baselines.paper.optimal_profiles --again --seed 1 --json other.json
    """

    json: Path = DATA
    """File of the results."""
    seed: int = SEED
    """Seed of the searches."""
    generations: int = GENERATIONS
    """Generations of each search."""
    again: bool = False
    """Solve the problems that the file holds again."""
    check: bool = False
    """Assess the solutions of the file again and search nothing; exit status 1 where one differs from its record."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing: `--help` needs no compiler.
    from baselines.paper.profile_search import Found, check, load, solve
    from baselines.paper.report import optimal_profiles_text

    found = Found(args.seed, args.generations, [], {})
    if args.json.exists() and (args.check or not args.again):
        found = load(args.json)
    if args.check:
        wrong = check(found.solutions)
        print(optimal_profiles_text(found), *wrong, sep="\n")
        return 1 if wrong or not found.solutions else 0
    if (found.seed, found.generations) != (args.seed, args.generations):
        refuse(PROG, f"{args.json} holds searches with another seed or number of generations; --again replaces them")
    try:
        solve(found, args.json)
    except KeyboardInterrupt:
        print(f"interrupted; {args.json} keeps the results so far, call again to resume", file=sys.stderr)
        return 130
    print(optimal_profiles_text(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
