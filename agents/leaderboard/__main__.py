"""Writes and checks the leaderboard: every policy on every frozen set.

    python -m agents.leaderboard           writes leaderboard.json, LEADERBOARD.md and the head in the README
    python -m agents.leaderboard --check   fails where they are stale, and says what is

The check compares exactly: the policies listed, their descriptions and training seeds, the sets' hashes, the hash of
every checkpoint's model, normalisation and configuration, and the revisions they were trained at; LEADERBOARD.md and
the README's head must be what leaderboard.json renders to. Then it evaluates everything again with the code at hand
and compares the numbers:

- scripted policies, on sets where none of their episodes fails, to 0.1 %: feedback keeps them on their reference, so
  that machines differ by rounding only;
- all else to the largest of 3 %, 0.01 in the number's unit, and a quarter of the recorded interval, its ends to the
  whole of it; failures to 5 % of the episodes. The last bit of a network in float32 depends on the machine, and what
  is unstable amplifies it: with M and mu changed by 1 part in 10^14 the adaptive law, where it diverges, fails in 42
  episodes of `drift` instead of 39; with 1 part in 10^6 of noise on the actions of a PPO policy single episodes moved
  by up to 0.6 cm/s, and interquartile means by 0.1 %. A change of the physics by rounding moved no mean of a PPO policy
  by more than a tenth of its interval, and an end by up to half of it.

Versions of packages are recorded and not compared. Neither is any revision of the code: the numbers are, so that a
commit makes the leaderboard stale exactly where it changes them.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.evaluation.candidates import all_candidates
from agents.evaluation.sets import SET_NAMES, load_set
from agents.leaderboard.board import build, write
from agents.leaderboard.page import COMMAND
from agents.leaderboard.staleness import check

ROOT = Path(__file__).resolve().parents[2]


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be an integer >= 1, got {text}")
    return value


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=COMMAND, description="Evaluates every policy on every frozen set and writes LEADERBOARD.md."
    )
    parser.add_argument("--check", action="store_true", help="write nothing; fail where the leaderboard is stale")
    parser.add_argument("--jobs", type=_positive, default=os.cpu_count() or 1, help="processes (default: all cores)")
    options = parser.parse_args(arguments)
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
