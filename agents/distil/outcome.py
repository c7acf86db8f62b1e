"""The runs of one student together: taught, compared and published."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from agents.distil.run import COMPARED_SEED, distil, own_draws, read_result
from agents.distil.students import STUDENTS, Budget
from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, Episode, difference, evaluate, failures, scores
from agents.evaluation.policies import CHECKPOINTS, find_candidate
from agents.evaluation.statistics import estimate
from agents.study.jobs import check_revision
from agents.training.presets import RunError
from agents.training.signals import Stop
from baselines.tables import text_table
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY


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
    policies = {name: [run for folder in folders for run in find_candidate(str(folder)).policies]}
    policies |= {rival: list(find_candidate(rival).policies) for rival in student.rivals}
    speed = TABLE_METRICS["mean_speed"]
    rows = [
        ["policy", "runs", f"{speed.label} [95 %]", SHARE_OF_OPTIMUM.label, "failed", "student's lead (cm/s) [95 %]"]
    ]
    own: list[Episode] = []
    for label, runs in tqdm(policies.items(), "comparing", file=sys.stderr, disable=None):
        episodes = [episode for run in runs for episode in evaluate(run, draws)]
        own = own or episodes
        found, share = (estimate(scores(episodes, metric)).to_dict() for metric in (speed.name, SHARE_OF_OPTIMUM.name))
        lead = "" if label == name else speed.with_interval(difference(own, episodes, speed.name).to_dict(), sign=True)
        failed = f"{failures(episodes)}/{len(episodes)}"
        rows.append(
            [label, str(len(runs)), speed.with_interval(found), SHARE_OF_OPTIMUM.format(share["iqm"]), failed, lead]
        )
    return text_table(rows, left=1)


def publish(name: str, folders: dict[int, Path], checkpoints: Path = CHECKPOINTS) -> None:
    """Copies the policies of finished runs into the folders of their row and seed.

    Raises:
        RunError: if one was begun at a revision that nobody can check out.
    """
    for folder in folders.values():
        result = read_result(folder)
        assert result is not None
        check_revision(folder, result.revision)
    for seed, folder in folders.items():
        target = checkpoints / name / f"seed-{seed}"
        target.mkdir(parents=True, exist_ok=True)
        write_atomically(target / POLICY, (folder / POLICY).read_bytes())
