"""Trains what is not finished of a study, shows how far it is, and says what became of it."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from agents.study.backends import BACKENDS, Backend
from agents.study.jobs import Job, Outcome, best, evaluations
from agents.study.progress import Progress, brief
from agents.training.stopping import INTERRUPTED, Stop
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
        chosen = best(lines, job.config)
        if chosen is None:
            continue
        rows.append(
            [
                job.name,
                f"{lines[-1].steps:,}",
                brief(lines[-1].seconds),
                f"{chosen.steps:,}",
                f"{chosen.mean_speed:.2f}",
                f"{chosen.failed:.1%}",
            ]
        )
    return text_table(rows, left=1)


def tell(outcomes: Sequence[Outcome]) -> None:
    """Prints what the runs have come to on their own draws, and which of them failed."""
    print(results_table([outcome.job for outcome in outcomes]))
    print("Mean speed and failures of the best evaluation on the run's own draws, never on a frozen set.")
    tell_failures(outcomes)


def tell_failures(outcomes: Sequence[Outcome]) -> None:
    """Says on stderr which runs failed, and why."""
    for outcome in outcomes:
        if outcome.state == "failed":
            print(f"{outcome.job.name} failed: {outcome.reason}", file=sys.stderr)


def check_jobs(jobs: int | None) -> None:
    """Refuses a number of runs that cannot be trained at a time.

    Raises:
        ValueError: if it is below one.
    """
    if jobs is not None and jobs < 1:
        raise ValueError(f"--jobs must be an integer >= 1, got {jobs}")


def leave(main: Callable[[], int]) -> NoReturn:
    """Runs a command and ends the process at once: threads that wait for a run would be waited for.

    The second Ctrl-C ends it before its runs have ended. Their processes see that nobody waits for them, and follow.
    """
    try:
        status = main()
    except KeyboardInterrupt:
        status = INTERRUPTED
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
        status = 1
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(status)
