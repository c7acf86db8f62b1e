"""Distils the optimum into networks and compares them with it and with agents: `python -m agents.distillation`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.distillation.config import STUDENTS
from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, evaluate, failures, scores
from agents.evaluation.statistics import estimate, paired_difference
from agents.study.jobs import check_seeds
from agents.training.presets import RunError
from agents.training.signals import INTERRUPTED
from baselines.tables import text_table
from capsule_gym.command_line import Positional, parse, refuse

PROG = "python -m agents.distillation"
RUNS = Path("runs/distillation")
COMPARED_EPISODES = 256
# First seed of the validation plants of the comparison, far from other seeds.
COMPARED_SEED = 7_000_000


@dataclass(frozen=True)
class Args:
    """Distils the optimum into a network, and compares it with the expert and with agents on validation plants.

    Finished runs are skipped. Ctrl-C stops; the best policy so far is in the run's folder.

    Examples:
      python -m agents.distillation --seeds {0..4}
      python -m agents.distillation optimum-distilled-wide --seeds 0
    """

    name: Annotated[Positional[str], arg(metavar="NAME", help=f"One of {', '.join(STUDENTS)}.")] = "optimum-distilled"
    seeds: Annotated[tuple[int, ...], arg(metavar="N")] = (0, 1, 2)
    """Training seeds."""
    runs: Path = RUNS
    """Folder of the runs."""

    def check(self) -> None:
        """Raises an error for students and seeds that do not exist."""
        if self.name not in STUDENTS:
            raise ValueError(f"NAME must be one of {', '.join(STUDENTS)}, got {self.name!r}")
        check_seeds(self.seeds)


def comparison(name: str, folders: Sequence[Path]) -> str:
    """A table of the finished runs and their references on the same validation plants.

    Args:
        name: of the student.
        folders: of its runs.
    """
    from agents.distillation.dagger import validation_plants

    plants, speed = validation_plants(STUDENTS[name], COMPARED_SEED, COMPARED_EPISODES), TABLE_METRICS["mean_speed"]
    found = {name: [each for folder in folders for each in evaluate(folder, plants)]}
    found |= {reference: evaluate(reference, plants) for reference in STUDENTS[name].references}
    rows = [["policy", "runs", f"{speed.label} [95 %]", SHARE_OF_OPTIMUM.label, "failed", "student minus it [95 %]"]]
    own = scores(found[name], speed.name)
    for label, episodes in found.items():
        speeds, share = scores(episodes, speed.name), estimate(scores(episodes, SHARE_OF_OPTIMUM.name)).value
        gain = speed.with_interval(paired_difference(own, speeds).to_dict(), sign=True) if label != name else ""
        cells = [speed.with_interval(estimate(speeds).to_dict()), SHARE_OF_OPTIMUM.format(share)]
        rows.append([label, str(len(speeds)), *cells, f"{failures(episodes)}/{len(episodes)}", gain])
    return text_table(rows, left=1)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after the command line is checked: --help does not need torch.
    from agents.distillation.dagger import distil_all

    folders = {seed: args.runs / args.name / f"seed-{seed}" for seed in args.seeds}
    try:
        if not distil_all(args.name, folders):
            print("Stopped; the best policy so far is kept.")
            return INTERRUPTED
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    print(comparison(args.name, list(folders.values())))
    print(f"\nInterquartile means over {COMPARED_EPISODES} validation plants; differences plant by plant, cm/s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
