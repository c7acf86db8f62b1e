"""Writes and checks the leaderboard, every policy on every frozen set: `python -m agents.leaderboard`.

The check compares exactly: the policies listed, their descriptions and training seeds, the sets' hashes, the hash of
every policy's file, and the revisions they were trained at; LEADERBOARD.md and the README's head must be what
leaderboard.json renders to. Then it evaluates everything again with the code at hand and compares every digit:
networks, laws and plants give the same bits on every machine.

Versions of packages are recorded and not compared. Neither is any revision of the code: the numbers are, so that a
commit makes the leaderboard stale exactly where it changes them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.evaluation.candidates import all_candidates
from agents.evaluation.sets import SET_NAMES, load_set
from agents.leaderboard.board import build, write
from agents.leaderboard.check import check
from agents.leaderboard.page import COMMAND
from capsule_gym.command_line import parse, refuse

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Options:
    """Evaluates every policy on every frozen set and writes leaderboard.json, LEADERBOARD.md and the README's head.

    Examples:
      python -m agents.leaderboard            write them
      python -m agents.leaderboard --check    fail where they are stale, and say what is
    """

    check: bool = False
    """Write nothing; fail where the leaderboard is stale."""
    jobs: int = os.cpu_count() or 1
    """Processes."""


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    if options.jobs < 1:
        refuse(COMMAND, f"--jobs must be an integer >= 1, got {options.jobs}")
    sets = [load_set(name) for name in SET_NAMES]
    candidates = all_candidates()
    if options.check:
        stale = check(root, candidates, sets, jobs=options.jobs)
        if stale:
            print("The leaderboard is stale:", *stale, sep="\n- ")
            print(f"Run `{COMMAND}` and commit what it writes.")
            return 1
        print(f"The leaderboard is up to date: {len(candidates)} policies on {len(sets)} sets.")
        return 0
    write(root, build(candidates, sets, jobs=options.jobs))
    print(f"Written: {len(candidates)} policies on {len(sets)} sets, to {root / 'LEADERBOARD.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
