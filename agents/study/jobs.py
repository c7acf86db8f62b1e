"""The runs of a study: one per row and training seed, each in its own folder, from which it can be resumed."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from agents.evaluation.criteria import CRITERIA
from agents.training.config import BEST, CONFIG, EVALUATIONS, Config, RunError, read_config
from agents.training.presets import row_settings
from baselines.evaluation.policies import CHECKPOINTS
from baselines.tables import text_table
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY

# Written into a run's folder when its training is complete.
FINISHED = "finished"


@dataclass(frozen=True)
class Job:
    """One run of a study: row of the leaderboard, its settings with the training seed, and the run's folder."""

    row: str
    config: Config
    run: Path

    @property
    def name(self) -> str:
        """The name in tables."""
        return f"{self.row}/{self.run.name}"

    @property
    def finished(self) -> bool:
        """Whether the training is complete."""
        return (self.run / FINISHED).is_file()


def plan(rows: Sequence[str], seeds: Sequence[int], folder: Path) -> list[Job]:
    """Lists the runs of a study: the first seed of every row, then the second seed of every row, and so on.

    Raises:
        RunError: if a run's folder exists and holds no run, or a run with other settings.
        ValueError: if a row does not exist, or a seed is out of range.
    """
    jobs = [
        Job(row, dataclasses.replace(row_settings(row), seed=seed), folder / row / f"seed-{seed}")
        for seed in seeds
        for row in rows
    ]
    for job in jobs:
        job.config.check()
        if job.run.exists():
            check_settings(job)
    return jobs


def check_settings(job: Job) -> None:
    """Checks that a run was started with the current settings of its job.

    Raises:
        RunError: if the settings differ, or the run's folder is broken.
    """
    begun, now = read_config(job.run).to_dict(), job.config.to_dict()
    changed = [f"{name} was {begun.get(name)!r} and is {now[name]!r}" for name in now if begun.get(name) != now[name]]
    if changed:
        raise RunError(f"{job.run} contains a run with other settings ({', '.join(changed)}): move it")


def train_job(job: Job) -> str:
    """Trains or resumes a run until its end; writes its output to the file seed-N.log next to its folder.

    Returns the reason for a failure, or an empty string: one run cannot stop a study.
    """
    # Imported here, since torch takes seconds to import and only workers need it.
    from agents.training.loop import begin, train

    path = job.run.with_name(f"{job.run.name}.log")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8", buffering=1) as log, redirect_stdout(log), redirect_stderr(log):
        try:
            if not job.run.exists():
                begin(job.run, job.config)
            if not train(job.run):
                return "stopped by a signal"
            (job.run / FINISHED).touch()
        except Exception as error:
            traceback.print_exc()
            return f"{error} (see {path})"
    return ""


def train_all(
    jobs: Sequence[Job], parallel: int | None = None, backend: Literal["loky", "ray"] = "loky"
) -> dict[Job, str]:
    """Trains or resumes the runs that are not finished, `parallel` at a time (one per core by default).

    Ctrl-C stops all runs; each can be resumed from its last checkpoint. The backend `ray` uses the cluster that
    RAY_ADDRESS names, or a new one on this machine; all machines need the checkout and the runs at the same paths. If a
    machine is lost, its runs are resumed on another one.

    Returns:
        The reasons for the failures, by run.
    """
    # Imported here, since both take long.
    from joblib import Parallel, delayed

    waiting = [job for job in jobs if not job.finished]
    if backend == "ray" and waiting:
        found = _train_on_ray([dataclasses.replace(job, run=job.run.resolve()) for job in waiting], parallel)
        return {job: reason for job, reason in zip(waiting, found, strict=True) if reason}
    try:
        # One run per task, since joblib would otherwise batch several short runs.
        work = Parallel(parallel or -1, verbose=10, batch_size=1, pre_dispatch="n_jobs")
        found = work(delayed(train_job)(job) for job in waiting)
    except Exception as error:
        # `train_job` does not raise: a worker was killed.
        reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}; --resume continues"
        found = ["" if job.finished else reason for job in waiting]
    return {job: reason for job, reason in zip(waiting, found, strict=True) if reason}


def _train_on_ray(jobs: Sequence[Job], parallel: int | None) -> list[str]:
    """Trains or resumes runs on a Ray cluster; a run whose node is lost is resumed on another one.

    joblib's backend for Ray would wait forever for a lost node, whose actor holds its place.

    Returns:
        The reasons for the failures, as `train_job`.
    """
    import ray

    root = str(Path(__file__).resolve().parents[2])
    ray.init(runtime_env={"env_vars": {"PYTHONPATH": root}}, log_to_driver=False, logging_level="error")
    try:
        # Ray starts as many as it has processors.
        task = ray.remote(num_cpus=1, max_retries=-1)(train_job)
        running: dict[Any, int] = {}
        reasons = [""] * len(jobs)
        progress = tqdm(total=len(jobs), unit=" runs", disable=None)
        for i, job in enumerate(jobs):
            running[task.remote(job)] = i
            while running and (len(running) == parallel or i == len(jobs) - 1):
                (done,), _ = ray.wait(list(running))
                try:
                    reasons[running[done]] = ray.get(done)
                except ray.exceptions.RayError as error:
                    reasons[running[done]] = f"{type(error).__name__}: {error}; --resume continues"
                del running[done]
                progress.update()
        progress.close()
    finally:
        ray.shutdown()
    return reasons


def results_table(jobs: Sequence[Job]) -> str:
    """The runs that have begun as a table, each with the evaluation of its best policy so far."""
    rows = [["run", "steps", "best at", "best"]]
    for job in jobs:
        if not (path := job.run / EVALUATIONS).is_file():
            continue
        with path.open(newline="", encoding="utf-8") as file:
            lines = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
        criteria = CRITERIA[job.config.env_task]
        chosen = max(lines, key=lambda line: line[f"score_{criteria.suffix}"])
        best = criteria.describe(chosen | {criteria.metric.name: chosen[criteria.column]})
        rows.append([job.name, *(f"{line['steps']:,.0f}" for line in (lines[-1], chosen)), best])
    return text_table(rows, left=1)


def publish(job: Job, checkpoints: Path = CHECKPOINTS) -> Path:
    """Copies a run's best policy and its evaluations into the folder of its row and seed, and returns that folder.

    Raises:
        RunError: if the run is not finished, its settings differ from those of its row, or its code was not committed.
    """
    if not job.finished:
        raise RunError(f"{job.run} is not finished")
    check_settings(job)
    revision = json.loads((job.run / CONFIG).read_text(encoding="utf-8")).get("revision")
    if not re.fullmatch(r"[0-9a-f]+", str(revision)):
        raise RunError(f"{job.run} must be a run of committed code, got the revision {revision!r}: train it again")
    folder = checkpoints / job.row / f"seed-{job.config.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    for path in (job.run / EVALUATIONS, job.run / BEST / POLICY):
        write_atomically(folder / path.name, path.read_bytes())
    return folder
