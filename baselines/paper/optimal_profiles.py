"""Optimises the parameters of the paper's seven-phase profile (9): `python -m baselines.paper.optimal_profiles`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capsule_gym.command_line import check_output, parse, refuse

PROG = "python -m baselines.paper.optimal_profiles"
DATA = Path(__file__).with_name("optimal_profiles.json")
GENERATIONS = 200
SEED = 0


@dataclass(frozen=True)
class Args:
    """Optimises the paper's profile (9) for speed, under exact tracking, Principles 1 to 4 and a torque limit.

    About half an hour on one core. Ctrl-C keeps the solutions so far in a file of their own.

    Examples:
      python -m baselines.paper.optimal_profiles --json mine.json     solve all problems
      python -m baselines.paper.optimal_profiles --check              assess the committed solutions again
    """

    json: Path = DATA
    """File of the results."""
    seed: int = SEED
    """Seed of the searches."""
    generations: int = GENERATIONS
    """Generations of each search."""
    overwrite: bool = False
    """Replace an existing file."""
    check: bool = False
    """Assess the solutions of the file again and search nothing; exit status 1 where one differs from its record."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing: `--help` needs no compiler.
    from baselines.paper.profile_search import check, load, partial_path, solve
    from baselines.paper.report import optimal_profiles_text

    try:
        if not args.check:
            check_output("--json", args.json, overwrite=args.overwrite)
        solutions = load(args.json) if args.check else solve(args.json, args.seed, args.generations)
    except (ValueError, OSError) as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print(f"\ninterrupted: the solutions so far are in {partial_path(args.json)}", file=sys.stderr)
        return 130
    wrong = check(solutions)
    print(optimal_profiles_text(solutions), *wrong, sep="\n")
    return 1 if wrong or not solutions else 0


if __name__ == "__main__":
    sys.exit(main())
