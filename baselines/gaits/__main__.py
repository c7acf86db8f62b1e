"""Searches the best-known gaits and writes them to `gait_data/`.

    python -m baselines.gaits --minutes 25   searches on, from what is known
    python -m baselines.gaits --oracle       makes the oracle's map again, from what is known
    python -m baselines.gaits --check        simulates every entry again and writes nothing

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

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

from baselines.gaits.archive import FOLDER, Archive, load_archive
from baselines.gaits.families import FAMILIES
from baselines.gaits.rounds import LARGEST_SENSITIVITY, PURPOSES, Search
from baselines.gaits.simulation import choose, recheck
from capsule_gym.files import write_atomically

# Rounding differs between machines and a gait may amplify it, by as much as the search lets a thousandth do.
CHECK_TOLERANCE = LARGEST_SENSITIVITY


def check(archive: Archive, threads: int) -> list[str]:
    """Simulates every entry again; returns what differs from its record by more than the tolerance, one line each."""
    stale = []
    gaits = archive.everything()
    for gait, speed, transport in zip(gaits, *recheck(gaits, threads=threads), strict=True):
        for name, old, new in (
            ("mean_speed", gait.mean_speed, speed),
            ("cost_of_transport", gait.cost_of_transport, transport),
        ):
            if not abs(new - old) <= CHECK_TOLERANCE * abs(old):
                stale.append(
                    f"{gait.family} at M={gait.M}, mu={gait.mu}: {name} is {old:.6g} on file and {new:.6g} now"
                )
    return stale


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"must be a number > 0, got {text}")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m baselines.gaits",
        description="Searches the best-known gaits. Goes on from what is known; Ctrl-C keeps what has been found.",
    )
    parser.add_argument("--check", action="store_true", help="simulate every entry again, write nothing")
    parser.add_argument("--oracle", action="store_true", help="only make the oracle's map again")
    parser.add_argument("--minutes", type=_positive, default=25.0, help="how long to search (default: 25)")
    parser.add_argument("--rounds", type=_positive, default=math.inf, help="rounds at most (default: as time allows)")
    parser.add_argument(
        "--families", nargs="+", choices=list(FAMILIES), default=list(FAMILIES), help="that take turns (default: all)"
    )
    parser.add_argument(
        "--purposes", nargs="+", choices=list(PURPOSES), default=list(PURPOSES), help="that take turns (default: all)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the search (default: 0)")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="for the batch (default: all cores)")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of gaits.json and oracle.json")
    options = parser.parse_args(arguments)
    archive = load_archive(options.folder)
    if options.check:
        stale = check(archive, options.threads)
        print(*stale, sep="\n")
        print(f"{len(archive.everything())} gaits simulated again: {len(stale)} numbers differ")
        return int(bool(stale))
    if not options.oracle:
        search = Search(
            archive,
            families=options.families,
            purposes=options.purposes,
            seed=options.seed,
            threads=options.threads,
            report=lambda line: print(line, flush=True),
            command=f"python -m baselines.gaits --seed {options.seed} --families {' '.join(options.families)} "
            f"--purposes {' '.join(options.purposes)}",
        )
        interrupted = search.run(
            minutes=options.minutes,
            rounds=options.rounds,
            save=lambda found: write_atomically(options.folder / "gaits.json", found.to_json()),
        )
        print(
            f"searched for {perf_counter() - search.began:.0f} s; in all {archive.rounds} rounds, "
            f"{archive.evaluations} candidates and {archive.seconds:.0f} s"
        )
        if interrupted:
            print("the oracle's map is as it was; call again to go on, or with --oracle to make the map")
            return 130
    if not archive.library():
        print(f"{options.folder} holds no gait to make the oracle's map of")
        return 1
    print("making the oracle's map (a minute or two)", flush=True)
    write_atomically(options.folder / "oracle.json", choose(archive.library(), threads=options.threads).to_json())
    return 0


if __name__ == "__main__":
    sys.exit(main())
