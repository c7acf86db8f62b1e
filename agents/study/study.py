"""Trains what is not finished of a study, shows how far it is, and says what became of it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.study.backends import BACKENDS, Backend
from agents.study.jobs import Job, Outcome, evaluations
from agents.study.progress import Progress, brief
from agents.training.stopping import Stop
from baselines.tables import text_table


def train_all(
    jobs: Sequence[Job], folder: Path, parallel: int | None = None, backend: Backend = "local"
) -> list[Outcome]:
    """Trains the runs that are not finished, or goes on with them, until all are or the user stops them.

    Args:
        jobs: the runs.
        folder: where the file is put that tells them to stop.
        parallel: how many are trained at a time; None for as many as there are cores.
        backend: where.

    Returns:
        How each ended, those that were finished before included, in the order of `jobs`.
    """
    waiting = [job for job in jobs if not job.finished]
    outcomes = {job.name: Outcome(job, "finished") for job in jobs if job.finished}
    if not waiting:
        return [outcomes[job.name] for job in jobs]
    folder.mkdir(parents=True, exist_ok=True)
    stop_file = folder / f".stop-{os.getpid()}"
    stop_file.unlink(missing_ok=True)
    try:
        with Stop() as stop, Progress(waiting, len(outcomes), parallel or os.cpu_count() or 1, stop, stop_file):
            for outcome in BACKENDS[backend](waiting, parallel, stop_file):
                outcomes[outcome.job.name] = outcome
    finally:
        stop_file.unlink(missing_ok=True)
    return [outcomes.get(job.name, Outcome(job, "stopped")) for job in jobs]


def results_table(jobs: Sequence[Job]) -> str:
    """What the runs have come to, each at the evaluation whose policy is its best."""
    rows = [["run", "steps", "training", "best at", "cm/s", "failed"]]
    for job in jobs:
        lines = evaluations(job.run)
        if not lines:
            continue
        best = max(lines, key=lambda line: line.mean_speed)
        rows.append(
            [
                job.name,
                f"{lines[-1].steps:,}",
                brief(lines[-1].seconds),
                f"{best.steps:,}",
                f"{best.mean_speed:.2f}",
                f"{best.failed:.1%}",
            ]
        )
    return text_table(rows, left=1)


def tell(outcomes: Sequence[Outcome]) -> None:
    """Prints what the runs have come to on their own draws, and on stderr which of them failed and why."""
    print(results_table([outcome.job for outcome in outcomes]))
    print("Mean speed and failures of the best evaluation on the run's own draws, never on a frozen set.")
    for outcome in outcomes:
        if outcome.state == "failed":
            print(f"{outcome.job.name} failed: {outcome.reason}", file=sys.stderr)
