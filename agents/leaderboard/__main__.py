"""Writes and checks the leaderboard, every policy on every frozen set: `python -m agents.leaderboard`.

The episodes of all policies are written to agents/leaderboard/results; leaderboard.json, LEADERBOARD.md and the
README's head are made from these files alone. `agents.leaderboard.check` says what --check compares.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.evaluation.policies import all_candidates
from agents.leaderboard.check import check
from agents.leaderboard.page import COMMAND, build, write
from agents.leaderboard.rows import RESULTS, evaluate, load_rows, save_row
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.parameters import nearest

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Args:
    """Evaluates policies on every frozen set, and writes leaderboard.json, LEADERBOARD.md and the README's head.

    Examples:
      python -m agents.leaderboard                    evaluate every policy and write everything
      python -m agents.leaderboard direct-ppo         evaluate these, and write everything from the results
      python -m agents.leaderboard --from-results     evaluate none
      python -m agents.leaderboard --check            fail if anything is stale, and print it
    """

    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = ()
    """Policies to evaluate, or to check by evaluating; all of them where there is no name."""
    check: bool = False
    """Write nothing; fail if the leaderboard is stale."""
    from_results: bool = False
    """Evaluate nothing: write, or check, what the results give."""
    jobs: int = os.cpu_count() or 1
    """Processes."""


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    try:
        if args.jobs < 1:
            raise ValueError(f"--jobs must be an integer >= 1, got {args.jobs}")
        if args.names and args.from_results:
            raise ValueError(f"--from-results must stand without names, got {' '.join(args.names)}")
        candidates = all_candidates()
        names = [candidate.name for candidate in candidates]
        unknown = [name for name in args.names if name not in names]
        if unknown:
            near = nearest(unknown[0], names)
            raise ValueError(f"names must be out of {', '.join(names)}, got {', '.join(unknown)}{near}")
    except ValueError as error:
        refuse(COMMAND, str(error))
    chosen = [] if args.from_results else [each for each in candidates if each.name in (args.names or names)]
    sets = [load_set(name) for name in SET_NAMES]
    if args.check:
        stale = check(root, candidates, sets, evaluated=chosen, jobs=args.jobs)
        if stale:
            print("The leaderboard is stale:", *stale, sep="\n- ")
            print(f"Run `{COMMAND}` and commit what it writes.")
            return 1
        print(f"The leaderboard is up to date: {len(candidates)} policies on {len(sets)} sets.")
        return 0
    try:
        for row in evaluate(chosen, sets, jobs=args.jobs):
            save_row(root / RESULTS, row)
    except KeyboardInterrupt:
        print(f"Stopped. The rows that were finished are kept in {root / RESULTS}; the pages are as they were.")
        return 130
    try:
        board = build(load_rows(root / RESULTS, names), sets)
    except ValueError as error:
        refuse(COMMAND, f"{error}; `{COMMAND} NAME` evaluates it")
    write(root, board)
    print(f"Written: {len(candidates)} policies on {len(sets)} sets, to {root / 'LEADERBOARD.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
