"""Distils the optimum into networks and compares them with it and with agents: `python -m agents.distillation`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tqdm import tqdm
from tyro.conf import arg

from agents.distillation.config import STUDENTS, Budget
from agents.evaluation.episodes import (
    SHARE_OF_OPTIMUM,
    TABLE_METRICS,
    Episode,
    difference,
    evaluate,
    failures,
    scores,
)
from agents.evaluation.policies import CHECKPOINTS, find_candidate
from agents.evaluation.statistics import estimate
from agents.study.jobs import check_revision, seeds_of
from agents.training.presets import RunError
from agents.training.signals import INTERRUPTED
from baselines.tables import text_table
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY

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
      python -m agents.distillation --seeds 0-4 --publish
      python -m agents.distillation optimum-distilled-wide --seeds 0
    """

    name: Annotated[Positional[str], arg(metavar="NAME", help=f"One of {', '.join(STUDENTS)}.")] = "optimum-distilled"
    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-2",)
    """Training seeds, and ranges of them such as 0-9."""
    runs: Path = RUNS
    """Folder of the runs."""
    publish: bool = False
    """Copy the policies into agents/checkpoints."""

    def check(self) -> None:
        """Raises an error for students and seeds that do not exist."""
        if self.name not in STUDENTS:
            raise ValueError(f"NAME must be one of {', '.join(STUDENTS)}, got {self.name!r}")
        seeds_of(self.seeds)


def comparison(name: str, folders: Sequence[Path], count: int) -> str:
    """A table of the finished runs and their references on the same validation plants.

    Args:
        name: of the student.
        folders: of its runs.
        count: plants.
    """
    from agents.distillation.dagger import validation_plants

    student = STUDENTS[name]
    plants = validation_plants(student, COMPARED_SEED, count)
    policies = {name: [policy for folder in folders for policy in find_candidate(str(folder)).policies]}
    policies |= {reference: list(find_candidate(reference).policies) for reference in student.references}
    speed = TABLE_METRICS["mean_speed"]
    rows = [["policy", "runs", f"{speed.label} [95 %]", SHARE_OF_OPTIMUM.label, "failed", "student minus it [95 %]"]]
    own: list[Episode] = []
    for label, runs in tqdm(policies.items(), "comparing", file=sys.stderr, disable=None):
        episodes = [episode for policy in runs for episode in evaluate(policy, plants)]
        own = own or episodes
        mean, share = (estimate(scores(episodes, each.name)).to_dict() for each in (speed, SHARE_OF_OPTIMUM))
        gain = "" if label == name else speed.with_interval(difference(own, episodes, speed.name).to_dict(), sign=True)
        counts = f"{failures(episodes)}/{len(episodes)}"
        cells = [speed.with_interval(mean), SHARE_OF_OPTIMUM.format(share["iqm"]), counts, gain]
        rows.append([label, str(len(runs)), *cells])
    return text_table(rows, left=1)


def publish(name: str, folders: dict[int, Path], checkpoints: Path = CHECKPOINTS) -> None:
    """Copies the policies of finished runs into the folders of their row and seed.

    Raises:
        RunError: if one was started at a revision that nobody can check out.
    """
    from agents.distillation.dagger import read_result

    for folder in folders.values():
        result = read_result(folder)
        assert result is not None
        check_revision(folder, result.revision)
    for seed, folder in folders.items():
        target = checkpoints / name / f"seed-{seed}"
        target.mkdir(parents=True, exist_ok=True)
        write_atomically(target / POLICY, (folder / POLICY).read_bytes())


def main(
    arguments: Sequence[str] | None = None, *, budget: Budget | None = None, count: int = COMPARED_EPISODES
) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after the command line is checked: --help does not need torch.
    from agents.distillation.dagger import distil_all

    folders = {seed: args.runs / args.name / f"seed-{seed}" for seed in seeds_of(args.seeds)}
    try:
        if not distil_all(args.name, folders, budget or STUDENTS[args.name].budget):
            print("Stopped; the best policy so far is kept.")
            return INTERRUPTED
        if args.publish:
            publish(args.name, folders)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    print(comparison(args.name, list(folders.values()), count))
    print(f"\nInterquartile means over {count} validation plants; differences plant by plant, cm/s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
