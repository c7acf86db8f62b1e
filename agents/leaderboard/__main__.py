"""Writes and checks the leaderboard, every policy on every frozen set: `python -m agents.leaderboard`.

Evaluations make results, the numbers of all episodes of a policy in one file of agents/leaderboard/results. Results
make leaderboard.json, LEADERBOARD.md and the README's head, and nothing else does.

The check compares exactly: the policies listed, their descriptions and training seeds, the sets' hashes, the hash of
every policy's file, and the revisions they were trained at; what is made of the results must be what they give. Then it
evaluates everything again with the code at hand and compares every digit of every episode: networks, laws and plants
give the same bits on every machine.

Versions of packages are recorded and not compared. Neither is any revision of the code: the numbers are, so that a
commit makes the leaderboard stale exactly where it changes them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.evaluation.policies import Candidate, all_candidates
from agents.leaderboard.board import build, evaluate, write
from agents.leaderboard.check import check
from agents.leaderboard.page import COMMAND
from agents.leaderboard.rows import RESULTS, load_rows, save_row
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.parameters import nearest

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Options:
    """Evaluates policies on every frozen set, and writes leaderboard.json, LEADERBOARD.md and the README's head.

    Examples:
      python -m agents.leaderboard                    evaluate every policy and write everything
      python -m agents.leaderboard direct-ppo         evaluate these, and write everything from the results
      python -m agents.leaderboard --from-results     evaluate none
      python -m agents.leaderboard --check            fail where anything is stale, and say what is
    """

    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = ()
    """Policies to evaluate, or to check by evaluating; all of them where there is no name."""
    check: bool = False
    """Write nothing; fail where the leaderboard is stale."""
    from_results: bool = False
    """Evaluate nothing: write, or check, what the results give."""
    jobs: int = os.cpu_count() or 1
    """Processes."""

    def check_values(self) -> None:
        """Refuses options that contradict each other or are out of range."""
        if self.jobs < 1:
            raise ValueError(f"--jobs must be an integer >= 1, got {self.jobs}")
        if self.names and self.from_results:
            raise ValueError(f"--from-results must stand without names, got {' '.join(self.names)}")


def _chosen(options: Options, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The policies to evaluate."""
    if options.from_results:
        return []
    unknown = [name for name in options.names if name not in [candidate.name for candidate in candidates]]
    if unknown:
        known = [candidate.name for candidate in candidates]
        near = nearest(unknown[0], known)
        raise ValueError(f"names must be out of {', '.join(known)}, got {', '.join(unknown)}{near}")
    return [candidate for candidate in candidates if candidate.name in (options.names or [candidate.name])]


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    try:
        options.check_values()
        candidates = all_candidates()
        chosen = _chosen(options, candidates)
    except ValueError as error:
        refuse(COMMAND, str(error))
    sets = [load_set(name) for name in SET_NAMES]
    if options.check:
        stale = check(root, candidates, sets, evaluated=chosen, jobs=options.jobs)
        if stale:
            print("The leaderboard is stale:", *stale, sep="\n- ")
            print(f"Run `{COMMAND}` and commit what it writes.")
            return 1
        print(f"The leaderboard is up to date: {len(candidates)} policies on {len(sets)} sets.")
        return 0
    try:
        for row in evaluate(chosen, sets, jobs=options.jobs):
            save_row(root / RESULTS, row)
    except KeyboardInterrupt:
        print(f"Stopped. The rows that were finished are kept in {root / RESULTS}; the pages are as they were.")
        return 130
    try:
        board = build(load_rows(root / RESULTS, [candidate.name for candidate in candidates]), sets)
    except ValueError as error:
        refuse(COMMAND, f"{error}; `{COMMAND} NAME` evaluates it")
    write(root, board)
    print(f"Written: {len(candidates)} policies on {len(sets)} sets, to {root / 'LEADERBOARD.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
