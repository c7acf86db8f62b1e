"""Searches the best-known gaits and writes them to `data/`: `python -m baselines.gaits`.

The search goes in rounds. A round takes one family of gaits and one purpose, and runs a CMA-ES for every plant of the
grid side by side, all candidates of all plants in one batch: `explore` starts from the best of random gaits, `refine`
from the best known gaits of any plant, tried on this one, and both look at the speed in the second half of 12 s;
`finish` does as `refine` with smaller steps and looks at the whole 33 s; `front` looks, over 33 s on the nominal plant,
for the cheapest gait of at least a given speed; `tolerate` looks for the gait whose slowest run with M 10 % and mu
about 20 % off is fastest, for the policies that must not fail beside the plant a gait was made for. Families and
purposes take turns for as long as the search is let.

What is known changes only for the better, and is written, whole or not at all, after every round and on Ctrl-C. So the
search can be interrupted at any time; called again it goes on with the next round.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from baselines.gaits import FOLDER
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.files import write_atomically

if TYPE_CHECKING:
    from baselines.gaits.archive import Archive

PROG = "python -m baselines.gaits"


def check(archive: Archive, threads: int) -> list[str]:
    """Simulates every entry again; returns what differs from its record by more than the tolerance, one line each.

    Rounding differs between machines and a gait may amplify it, by as much as the search lets a thousandth do: that is
    the tolerance.
    """
    from baselines.gaits.rounds import LARGEST_SENSITIVITY
    from baselines.gaits.simulation import recheck

    stale = []
    gaits = archive.everything()
    for gait, speed, transport in zip(gaits, *recheck(gaits, threads=threads), strict=True):
        for name, old, new in (
            ("mean_speed", gait.mean_speed, speed),
            ("cost_of_transport", gait.cost_of_transport, transport),
        ):
            if not abs(new - old) <= LARGEST_SENSITIVITY * abs(old):
                stale.append(
                    f"{gait.family} at M={gait.M}, mu={gait.mu}: {name} is {old:.6g} on file and {new:.6g} now"
                )
    return stale


@dataclass(frozen=True)
class Options:
    """Searches the best-known gaits. Goes on from what is known; Ctrl-C keeps what has been found.

    Examples:
      python -m baselines.gaits --minutes 25    search on, from what is known
      python -m baselines.gaits --oracle        make the oracle's map again, from what is known
      python -m baselines.gaits --check         simulate every entry again and write nothing
      python -m baselines.gaits --families harmonics --purposes refine finish
    """

    check: bool = False
    """Simulate every entry again, write nothing; the exit status says whether all are met."""
    oracle: bool = False
    """Only make the oracle's map again."""
    minutes: float = 25.0
    """How long to search."""
    rounds: Count = 0
    """Rounds at most; 0 for as many as the time allows."""
    families: tuple[str, ...] = ()
    """Families of gaits that take turns, of harmonics, bang-bang and phase-space; all where none is given."""
    purposes: tuple[str, ...] = ()
    """Purposes of the rounds that take turns, of explore, refine, finish, front and tolerate; all where none is
    given."""
    seed: int = 0
    """Of the search."""
    threads: int = os.cpu_count() or 1
    """For the batch."""
    folder: Path = FOLDER
    """Of gaits.json and oracle.json."""


def _refuse_wrong(options: Options) -> None:
    """Ends the command where an option cannot be meant."""
    if not options.minutes > 0.0:
        refuse(PROG, f"--minutes must be a number > 0, got {options.minutes:g}")
    if options.threads < 1:
        refuse(PROG, f"--threads must be at least 1, got {options.threads}")
    from baselines.gaits.families import FAMILIES
    from baselines.gaits.rounds import PURPOSES

    for name, given, known in (("--families", options.families, FAMILIES), ("--purposes", options.purposes, PURPOSES)):
        if not set(given) <= set(known):
            refuse(PROG, f"{name} must be some of {', '.join(known)}, got {' '.join(given)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    _refuse_wrong(options)
    # After the command line is known to be right: the help needs none of it.
    from baselines.gaits.archive import load_archive
    from baselines.gaits.simulation import choose

    archive = load_archive(options.folder)
    if options.check:
        stale = check(archive, options.threads)
        print(*stale, sep="\n")
        print(f"{len(archive.everything())} gaits simulated again: {len(stale)} numbers differ")
        return int(bool(stale))
    if not options.oracle and _search(options, archive):
        print("the oracle's map is as it was; call again to go on, or with --oracle to make the map")
        return 130
    if not archive.library():
        print(f"{options.folder} holds no gait to make the oracle's map of")
        return 1
    print("making the oracle's map (a minute or two)", flush=True)
    write_atomically(options.folder / "oracle.json", choose(archive.library(), threads=options.threads).to_json())
    return 0


def _search(options: Options, archive: Archive) -> bool:
    """Searches on; returns whether it was Ctrl-C that ended it."""
    from baselines.gaits.families import FAMILIES
    from baselines.gaits.rounds import PURPOSES, Search

    families, purposes = options.families or tuple(FAMILIES), options.purposes or tuple(PURPOSES)
    search = Search(
        archive,
        families=families,
        purposes=purposes,
        seed=options.seed,
        threads=options.threads,
        report=lambda line: print(line, flush=True),
        command=f"{PROG} --seed {options.seed} --families {' '.join(families)} --purposes {' '.join(purposes)}",
    )
    interrupted = search.run(
        minutes=options.minutes,
        rounds=options.rounds or math.inf,
        save=lambda found: write_atomically(options.folder / "gaits.json", found.to_json()),
    )
    print(
        f"searched for {perf_counter() - search.began:.0f} s; in all {archive.rounds} rounds, "
        f"{archive.evaluations} candidates and {archive.seconds:.0f} s"
    )
    return interrupted


if __name__ == "__main__":
    sys.exit(main())
