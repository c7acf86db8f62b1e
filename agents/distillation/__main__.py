"""Distils the optimum into networks: `python -m agents.distillation`."""

import sys
from pathlib import Path
from typing import Annotated

from agents.distillation.config import STUDENTS, for_rig
from agents.training.signals import INTERRUPTED
from capsule_gym import Fit
from capsule_gym.command_line import Count, Positional, arg, command, refuse

PROG = "python -m agents.distillation"


@command(PROG)
def main(
    name: Annotated[Positional[str], arg(metavar="NAME", help=f"One of {', '.join(STUDENTS)}.")],
    seeds: Annotated[tuple[Count, ...], arg(metavar="N")] = (0, 1, 2),
    rig: Annotated[Path | None, arg(metavar="FILE")] = None,
    runs: Path = Path("runs/distillation"),
) -> int:
    """Distils the optimum into a network.

    The training plants are solved first, once for all seeds; the file of a plant stays in the
    folder. Ctrl-C stops; the same command continues after the last fit, and skips finished runs.
    The best policy so far is in the run's folder.

    Examples:
      python -m agents.distillation dp-distilled --seeds {0..4}
      python -m agents.distillation dp-distilled-real --rig fit.json --seeds 0

    Args:
        name: student.
        seeds: Training seeds.
        rig: Identified rig, a file of `Fit.save`: plants and disturbances of its 95 % intervals
            replace those of the student.
        runs: Folder of the runs.
    """
    if name not in STUDENTS:
        refuse(PROG, f"NAME must be one of {', '.join(STUDENTS)}, got {name!r}")
    # Imported after the command line is checked: --help does not need torch.
    from agents.distillation.dagger import FINISHED, Run

    student = STUDENTS[name]
    folder = runs / name
    try:
        if rig is not None:
            student = for_rig(student, Fit.load(rig))
            folder = runs / f"{name}-{rig.stem}"
        for seed in seeds:
            run = folder / f"seed-{seed}"
            if not (run / FINISHED).is_file():
                Run(name, student, seed, run).train()
    except (OSError, ValueError) as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print("\nStopped; the same command continues. The best policy so far, if any, is kept.")
        return INTERRUPTED
    print(f"Distilled; python -m agents.evaluate {folder} --against dp-oracle compares it.")
    first = folder / f"seed-{seeds[0]}"
    print(f"For a microcontroller: python -m capsule_gym.export {first} --c policy.h")
    return 0


if __name__ == "__main__":
    sys.exit(main())
