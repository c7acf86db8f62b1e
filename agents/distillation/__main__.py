"""Distils the optimum into networks: `python -m agents.distillation`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from agents.distillation.config import STUDENTS
from agents.training.config import LARGEST_SEED
from agents.training.signals import INTERRUPTED
from capsule_gym.checks import check_integer
from capsule_gym.command_line import Positional, arg, parse, refuse

PROG = "python -m agents.distillation"
RUNS = Path("runs/distillation")


@dataclass(frozen=True)
class Args:
    """Distils the optimum into a network.

    Finished runs are skipped. Ctrl-C stops; the best policy so far is in the run's folder.

    Examples:
      python -m agents.distillation dp-distilled-wide --seeds {0..4}
    """

    name: Annotated[Positional[str], arg(metavar="NAME", help=f"One of {', '.join(STUDENTS)}.")]
    seeds: Annotated[tuple[int, ...], arg(metavar="N")] = (0, 1, 2)
    """Training seeds."""
    runs: Path = RUNS
    """Folder of the runs."""

    def check(self) -> None:
        """Raises an error if the student is unknown or a seed is out of range."""
        if self.name not in STUDENTS:
            raise ValueError(f"NAME must be one of {', '.join(STUDENTS)}, got {self.name!r}")
        for seed in self.seeds:
            check_integer("--seeds", seed, f"integers from 0 to {LARGEST_SEED}", 0, LARGEST_SEED)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after the command line is checked: --help does not need torch.
    from agents.distillation.dagger import FINISHED, distil

    folders = {seed: args.runs / args.name / f"seed-{seed}" for seed in args.seeds}
    waiting = {seed: folder for seed, folder in folders.items() if not (folder / FINISHED).is_file()}
    if started := [str(folder) for folder in waiting.values() if folder.exists()]:
        refuse(PROG, f"{', '.join(started)} is an unfinished run: remove it, or choose another folder with --runs")
    try:
        for seed, folder in waiting.items():
            distil(args.name, STUDENTS[args.name], seed, folder)
    except OSError as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print("\nStopped; the best policy so far is kept.")
        return INTERRUPTED
    print(f"Distilled; python -m agents.evaluate {args.runs / args.name} --against dp-oracle compares it.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
