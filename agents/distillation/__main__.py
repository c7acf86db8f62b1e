"""Distils the optimum into networks: `python -m agents.distillation`."""

import sys
from pathlib import Path
from typing import Annotated

from agents.distillation.config import STUDENTS
from agents.training.signals import INTERRUPTED
from capsule_gym.command_line import Count, Positional, arg, command, refuse

PROG = "python -m agents.distillation"


@command(PROG)
def main(
    name: Annotated[Positional[str], arg(metavar="NAME", help=f"One of {', '.join(STUDENTS)}.")],
    seeds: Annotated[tuple[Count, ...], arg(metavar="N")] = (0, 1, 2),
    runs: Path = Path("runs/distillation"),
) -> int:
    """Distils the optimum into a network.

    Finished runs are skipped. Ctrl-C stops; the best policy so far is in the run's folder.

    Examples:
      python -m agents.distillation dp-distilled-wide --seeds {0..4}

    Args:
        name: student.
        seeds: Training seeds.
        runs: Folder of the runs.
    """
    if name not in STUDENTS:
        refuse(PROG, f"NAME must be one of {', '.join(STUDENTS)}, got {name!r}")
    # Imported after the command line is checked: --help does not need torch.
    from agents.distillation.dagger import FINISHED, distil

    folders = {seed: runs / name / f"seed-{seed}" for seed in seeds}
    waiting = {seed: run for seed, run in folders.items() if not (run / FINISHED).is_file()}
    started = [str(folder) for folder in waiting.values() if folder.exists()]
    if started:
        reason = "is an unfinished run: remove it, or choose another folder with --runs"
        refuse(PROG, f"{', '.join(started)} {reason}")
    try:
        for seed, folder in waiting.items():
            distil(name, STUDENTS[name], seed, folder)
    except OSError as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print("\nStopped; the best policy so far, if any, is kept.")
        return INTERRUPTED
    print(f"Distilled; python -m agents.evaluate {runs / name} --against dp-oracle compares it.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
