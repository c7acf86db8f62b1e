"""Optimises the parameters of the paper's seven-phase profile (9): `python -m baselines.paper.optimal_profiles`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capsule_gym.command_line import check_output, parse

PROG = "python -m baselines.paper.optimal_profiles"
DATA = Path(__file__).with_name("optimal_profiles.json")


@dataclass(frozen=True)
class Args:
    """Optimises the paper's profile (9) for speed, under exact tracking, Principles 1 to 4 and a torque limit.

    About half an hour on one core. Ctrl-C keeps the solutions so far in a file of their own.

    Examples:
      python -m baselines.paper.optimal_profiles --json mine.json                     solve all problems
      python -m baselines.paper.optimal_profiles --json short.json --generations 5    a short search
    """

    json: Path = DATA
    """File of the results."""
    seed: int = 0
    """Seed of the searches."""
    generations: int = 200
    """Generations of each search."""
    overwrite: bool = False
    """Replace an existing file."""

    def check(self) -> None:
        """Raises an error for a path that cannot be written, before the computation."""
        check_output("--json", self.json, overwrite=self.overwrite)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing: `--help` needs no compiler.
    from baselines.paper.profile_search import solve

    try:
        solve(args.json, args.seed, args.generations)
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
