"""Searches for fast gaits and writes the best ones to `data/`: `python -m baselines.gaits`.

An iteration takes one family of gaits and one purpose: `explore` starts from the best of random gaits, `refine` from
the best known gaits of any plant; both maximise the speed over 12 s. `finish` refines with smaller steps over 33 s;
`front` looks, on the nominal plant, for the cheapest gait of at least a given speed; `tolerate` maximises the speed of
the slowest run with M 10 % and mu about 20 % off. Families and purposes take turns.

A gait in the archive is replaced only by a better one. The archive is written after every iteration, and the next call
continues from it. `--law` searches the parameters of the law `baselines:gait` in the same way.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.gaits import FOLDER
from capsule_gym.command_line import parse, refuse

PROG = "python -m baselines.gaits"


@dataclass(frozen=True)
class Args:
    """Searches for fast periodic gaits, starting from the archive. Ctrl-C keeps the results of finished iterations.

    Examples:
      python -m baselines.gaits --minutes 25    continue the search
      python -m baselines.gaits --minutes 0     only compute the map of gait-oracle
      python -m baselines.gaits --check         simulate every gait again and write nothing
      python -m baselines.gaits --law 700       search the parameters of baselines:gait
    """

    check: bool = False
    """Simulate every gait again, write nothing; the exit status is 1 if one differs."""
    law: int = 0
    """Generations of a search for the parameters of `baselines:gait`; 0 searches gaits instead."""
    minutes: float = 25.0
    """Duration of the search, min; the map of gait-oracle is computed at the end."""
    seed: int = 0
    """Seed of the search."""
    folder: Path = FOLDER
    """Folder of the archive."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing, since `--help` does not need these modules.
    from baselines.archive import run_search
    from baselines.gaits.archive import load_archive
    from baselines.gaits.search import check, compute_map, search

    if args.law:
        from baselines.gaits.law_search import search_law

        return 130 if run_search(search_law(args.law, args.seed), lambda: None) else 0
    try:
        archive = load_archive(args.folder)
    except ValueError as error:
        refuse(PROG, str(error))
    if args.check:
        stale = check(archive)
        print(*stale, f"{len(archive.everything())} gaits simulated again: {len(stale)} numbers differ", sep="\n")
        return int(bool(stale))
    if run_search(search(archive, args.seed, args.minutes), lambda: archive.save(args.folder)):
        return 130
    if not archive.gaits:
        print(f"{args.folder} holds no gait to compute the map of gait-oracle from")
        return 1
    print("computing the map of gait-oracle (some minutes)", flush=True)
    archive.oracle = compute_map(list(archive.gaits.values()))
    archive.save(args.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
