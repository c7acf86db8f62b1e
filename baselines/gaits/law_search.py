"""Searches the parameters of `baselines:gait`, a law that does not observe the plant, over the plants of `wide`.

A CMA-ES starts from the tolerant gait of the nominal plant. Each generation runs all candidates in one batch on newly
drawn plants, evenly over M and log(mu). Every plant jumps twice to another, and every second one has a random residual
torque: a law must be fast, tolerate changes and support a policy. At regular intervals the mean of the distribution
runs on fixed episodes; the best of these means replaces the parameters on file if it scores better.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capsule_gym.command_line import Count, parse

PROG = "python -m baselines.gaits.law_search"


@dataclass(frozen=True)
class Args:
    """Searches the parameters of `baselines:gait`. Ctrl-C keeps the best so far.

    The file is replaced only by parameters that score better than those in it.

    Examples:
      python -m baselines.gaits.law_search
      python -m baselines.gaits.law_search --seed 1 --generations 100 --file found.json
    """

    seed: int = 0
    """Of the search."""
    generations: Count = 700
    """Of the CMA-ES."""
    file: Path | None = None
    """Of the parameters; default: the file of `baselines:gait`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # After the options, so that the help comes without numba.
    from baselines.archive import run_search
    from baselines.gaits.law_candidates import Search
    from baselines.laws.gait import FILE

    command = f"{PROG} --seed {args.seed} --generations {args.generations}"
    search = Search(args.seed, args.generations, args.file or FILE, command)
    return 130 if run_search(search.generations(), search.save) else 0


if __name__ == "__main__":
    sys.exit(main())
