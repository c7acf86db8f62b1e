"""Distils the optimum into networks and compares them with it and with agents: `python -m agents.distil`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tqdm import tqdm
from tyro.conf import arg

from agents.distil.lessons import STUDENTS, Budget
from agents.distil.run import COMPARED_SEED, distil, own_draws, read_result
from agents.evaluation.candidates import CHECKPOINTS, find_candidate
from agents.evaluation.episodes import Episode, difference, failures, scores
from agents.evaluation.statistics import estimate
from agents.evaluation.tables import MEASURES, SHARE
from agents.study.jobs import seeds_of
from agents.study.publication import refuse_revision
from agents.training.errors import RunError
from agents.training.stopping import INTERRUPTED, Stop
from baselines.tables import text_table
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.committed import POLICY
from capsule_gym.files import write_bytes_atomically

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


def teach(name: str, folders: dict[int, Path], budget: Budget) -> bool:
    """Distils what is not finished; returns whether all are.

    Args:
        name: of the student.
        folders: of its runs, by the seed.
        budget: of each.

    Raises:
        RunError: if a run was begun before and did not come to its end.
    """
    waiting = {seed: folder for seed, folder in folders.items() if read_result(folder) is None}
    begun = [str(folder) for folder in waiting.values() if folder.exists()]
    if begun:
        raise RunError(f"{', '.join(begun)} was begun and is not finished: remove it, or give other --runs")
    with Stop() as stop:
        return all(distil(name, STUDENTS[name], seed, folder, stop, budget) for seed, folder in waiting.items())


def comparison(name: str, folders: Sequence[Path], count: int) -> str:
    """The finished runs together, beside their rivals on the same plants of own draws, as a table.

    Args:
        name: of the student.
        folders: of its runs.
        count: plants.
    """
    student = STUDENTS[name]
    draws = own_draws(student, COMPARED_SEED, count)
    policies = {name: [run for folder in folders for run in find_candidate(str(folder)).runs]}
    policies |= {rival: list(find_candidate(rival).runs) for rival in student.rivals}
    speed = MEASURES["mean_speed"]
    rows = [["policy", "runs", f"{speed.label} [95 %]", SHARE.label, "failed", "student's lead (cm/s) [95 %]"]]
    own: list[Episode] = []
    for label, runs in tqdm(policies.items(), "comparing", file=sys.stderr, disable=None):
        episodes = [episode for run in runs for episode in run.evaluate(draws)]
        own = own or episodes
        found, share = (estimate(scores(episodes, metric)).to_dict() for metric in (speed.metric, SHARE.metric))
        lead = (
            "" if label == name else speed.with_interval(difference(own, episodes, speed.metric).to_dict(), sign=True)
        )
        failed = f"{failures(episodes)}/{len(episodes)}"
        rows.append([label, str(len(runs)), speed.with_interval(found), SHARE.format(share["iqm"]), failed, lead])
    return text_table(rows, left=1)


def publish(name: str, folders: dict[int, Path], checkpoints: Path = CHECKPOINTS) -> None:
    """Copies the policies of finished runs into the folders of their row and seed.

    Raises:
        RunError: if one was begun at a revision that nobody can check out.
    """
    for folder in folders.values():
        result = read_result(folder)
        assert result is not None
        refuse_revision(folder, result.revision)
    for seed, folder in folders.items():
        target = checkpoints / name / f"seed-{seed}"
        target.mkdir(parents=True, exist_ok=True)
        write_bytes_atomically(target / POLICY, (folder / POLICY).read_bytes())


def main(
    arguments: Sequence[str] | None = None, *, budget: Budget | None = None, count: int = COMPARED_EPISODES
) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
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
