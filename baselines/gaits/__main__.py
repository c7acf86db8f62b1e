"""The best-known gaits, and the search of the law `baselines:gait`: `python -m baselines.gaits`."""

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
    """Prints the fastest known gait of every plant, simulates the gaits again, or searches the law `baselines:gait`.

    Examples:
      python -m baselines.gaits              the fastest gaits
      python -m baselines.gaits --check      simulate every gait again
      python -m baselines.gaits --law 700    search the parameters of baselines:gait
    """

    check: bool = False
    """Simulate every gait again; the exit status is 1 if one differs."""
    law: int = 0
    """Generations of a search for the parameters of `baselines:gait`."""
    seed: int = 0
    """Seed of the search."""
    folder: Path = FOLDER
    """Folder of the gaits."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing, since `--help` does not need these modules.
    from baselines.archive import run_search
    from baselines.gaits.archive import check, load_archive
    from baselines.tables import text_table

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
    cells = [["M (kg)", "mu", "family", "cm/s", "cost of transport"]]
    for (M, mu), gait in archive.fastest().items():
        cells.append([f"{M:g}", f"{mu:g}", gait.family, f"{gait.mean_speed:.2f}", f"{gait.cost_of_transport:.2f}"])
    print(text_table(cells))
    return 0


if __name__ == "__main__":
    sys.exit(main())
