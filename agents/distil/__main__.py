"""Distils the optimum into networks and compares them with it and with agents: `python -m agents.distil`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.distil.students import STUDENTS, Budget
from agents.study.jobs import seeds_of
from agents.training.presets import RunError
from agents.training.signals import INTERRUPTED
from capsule_gym.command_line import Positional, parse, refuse

PROG = "python -m agents.distil"
ROW = "optimum-distilled"
RUNS = Path("runs/distil")
COMPARED_EPISODES = 256


@dataclass(frozen=True)
class Options:
    """Distils the optimum into a network, and compares it with its teacher and with agents on plants of own draws.

    Called again, it passes over finished runs. Ctrl-C stops; the best policy so far is in the run's folder.

    Examples:
      python -m agents.distil --seeds 0-4 --publish
      python -m agents.distil optimum-distilled-wide --seeds 0
    """

    name: Annotated[Positional[str], arg(metavar="NAME", help=f"One of {', '.join(STUDENTS)}.")] = ROW
    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-2",)
    """Training seeds, and ranges of them such as 0-9."""
    runs: Path = RUNS
    """Folder of the runs."""
    publish: bool = False
    """Copy the policies into agents/checkpoints."""

    def check(self) -> None:
        """Refuses students and seeds that do not exist."""
        if self.name not in STUDENTS:
            raise ValueError(f"NAME must be one of {', '.join(STUDENTS)}, got {self.name!r}")
        seeds_of(self.seeds)


def main(
    arguments: Sequence[str] | None = None, *, budget: Budget | None = None, count: int = COMPARED_EPISODES
) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    # After the command line is known to be right: the help needs none of it.
    from agents.distil.outcome import comparison, publish, teach

    folders = {seed: options.runs / options.name / f"seed-{seed}" for seed in seeds_of(options.seeds)}
    try:
        if not teach(options.name, folders, budget or STUDENTS[options.name].budget):
            print("Stopped; the best policy so far is kept.")
            return INTERRUPTED
        if options.publish:
            publish(options.name, folders)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    print(comparison(options.name, list(folders.values()), count))
    print(f"\nInterquartile means over {count} plants of own draws, never a frozen set; differences plant by plant.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
