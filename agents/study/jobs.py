"""The runs of a study: one per row and training seed, each in a folder that resumes where it stopped."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import json
import re
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Literal

from agents.evaluation.policies import CHECKPOINTS
from agents.training.presets import BEST, CONFIG, EVALUATIONS, LARGEST_SEED, Config, RunError, read_config
from baselines.tables import text_table
from capsule_gym.files import to_json, write_atomically
from capsule_gym.parameters import check_integer
from capsule_gym.policy import POLICY

ROOT = Path(__file__).resolve().parents[2]
# Written into a run's folder when its training is complete.
FINISHED = "finished.json"

Backend = Literal["loky", "ray"]
# A line of evaluations.csv by its columns: `steps`, `seconds` and `core_seconds` of training so far, `mean_speed_cm_s`,
# the share of episodes that `failed` and `score_cm_s` (which selects the best policy).
Evaluation = dict[str, float]
score = itemgetter("score_cm_s")


@dataclass(frozen=True)
class Job:
    """One run of a study.

    Attributes:
        row: name of what is trained, a row of the leaderboard in `python -m agents.study`.
        config: its configuration, the training seed included.
        run: its folder.
    """

    row: str
    config: Config
    run: Path

    @property
    def name(self) -> str:
        """As it appears in tables."""
        return f"{self.row}/{self.run.name}"

    @property
    def finished(self) -> bool:
        """Whether its training is complete."""
        return (self.run / FINISHED).is_file()


def check_seeds(seeds: Sequence[int]) -> None:
    """Checks the training seeds of a command line.

    Raises:
        ValueError: if one is out of range.
    """
    for seed in seeds:
        check_integer("--seeds", seed, f"integers from 0 to {LARGEST_SEED}", 0, LARGEST_SEED)


def plan(settings: Mapping[str, Config], seeds: Sequence[int], folder: Path) -> list[Job]:
    """Lists the runs of a study: the first seed of every row, then the second seed of every row, and so on.

    Args:
        settings: configurations by the name of their row.
        seeds: training seeds.
        folder: of all runs; a run is in NAME/seed-N.

    Raises:
        RunError: if a run's folder exists and holds no run, or a run with other settings.
    """
    jobs = [
        Job(row, dataclasses.replace(config, seed=seed), folder / row / f"seed-{seed}")
        for seed in seeds
        for row, config in settings.items()
    ]
    for job in jobs:
        if job.run.exists():
            check_settings(job)
    return jobs


def check_settings(job: Job) -> None:
    """Checks that a run was begun with the settings that its job has now.

    Raises:
        RunError: if the settings differ, or the run's folder is broken.
    """
    # Compared as JSON, which has no tuples.
    begun, now = (json.loads(to_json(config.to_dict())) for config in (read_config(job.run), job.config))
    changed = [f"{name} was {begun.get(name)!r} and is {now[name]!r}" for name in now if begun.get(name) != now[name]]
    if changed:
        raise RunError(f"{job.run} holds a run with other settings ({', '.join(changed)}): move it elsewhere")


def train_job(job: Job) -> str:
    """Trains a run to its end, or resumes it; its output is written to the file seed-N.log next to its folder.

    Returns:
        The reason of a failure, or an empty string. It raises nothing, so that one run cannot stop a study.
    """
    # torch takes seconds to import, and only workers need it.
    from agents.training.loop import begin, train

    path = job.run.with_name(f"{job.run.name}.log")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8", buffering=1) as log:
        with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
            try:
                if not job.run.exists():
                    begin(job.run, job.config)
                if not train(job.run):
                    return "stopped by a signal"
                last = evaluations(job.run)[-1]
                write_atomically(job.run / FINISHED, to_json({name: last[name] for name in ("steps", "seconds")}))
            except Exception as error:
                traceback.print_exc()
                return f"{error} (see {path})"
    return ""


def train_all(jobs: Sequence[Job], parallel: int | None = None, backend: Backend = "loky") -> dict[Job, str]:
    """Trains the runs that are not finished, or resumes them, and prints joblib's progress to stderr.

    Ctrl-C stops all runs; each resumes later from its last checkpoint.

    Args:
        jobs: the runs.
        parallel: number of runs in parallel; None for one per core.
        backend: joblib's; `ray` is the cluster that RAY_ADDRESS names, or a new one on this machine. The machines of a
            cluster must have the checkout and the folder of the runs at the same paths.

    Returns:
        The reasons of the failures, by run.
    """
    from joblib import Parallel, delayed, parallel_config

    waiting = [job for job in jobs if not job.finished]
    try:
        if backend == "ray" and waiting:
            import ray
            from ray.util.joblib import register_ray

            ray.init(runtime_env={"env_vars": {"PYTHONPATH": str(ROOT)}}, log_to_driver=False, logging_level="error")
            register_ray()
            waiting = [dataclasses.replace(job, run=job.run.resolve()) for job in waiting]
        # One run per task: joblib would otherwise send several short ones together.
        with parallel_config(backend=backend, n_jobs=parallel or -1, verbose=10):
            found = Parallel(batch_size=1, pre_dispatch="n_jobs")(delayed(train_job)(job) for job in waiting)
    except Exception as error:
        # `train_job` raises nothing: this is the backend, for example because a worker was killed.
        reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]} The same command resumes."
        found = ["" if job.finished else reason for job in waiting]
    return {job: reason for job, reason in zip(waiting, found, strict=True) if reason}


def evaluations(run: Path) -> list[Evaluation]:
    """Reads the evaluations that a run has made so far; an empty list if it has not begun."""
    try:
        with (run / EVALUATIONS).open(encoding="utf-8", newline="") as file:
            # The last line may be incomplete while the run is in training.
            rows = [row for row in csv.DictReader(file) if None not in row.values()]
    except FileNotFoundError:
        return []
    return [{name: float(value) for name, value in row.items()} for row in rows]


def results_table(jobs: Sequence[Job]) -> str:
    """The runs as a table, each with the evaluation of its best policy."""
    rows = [["run", "steps", "best at", "cm/s", "failed"]]
    for job in jobs:
        lines = evaluations(job.run)
        if lines:
            chosen = max(lines, key=score)
            steps = (f"{line['steps']:,.0f}" for line in (lines[-1], chosen))
            rows.append([job.name, *steps, f"{chosen['mean_speed_cm_s']:.2f}", f"{chosen['failed']:.1%}"])
    return text_table(rows, left=1)


def publish(job: Job, checkpoints: Path = CHECKPOINTS) -> Path:
    """Copies a run's best policy and its evaluations into the folder of its row and seed, and returns that folder.

    Args:
        job: the run.
        checkpoints: the folder of all rows.

    Raises:
        RunError: if the run is not finished, has other settings than its row, or was begun at a revision that cannot
            be checked out.
    """
    if not job.finished:
        raise RunError(f"{job.run} is not finished")
    check_settings(job)
    revision = json.loads((job.run / CONFIG).read_text(encoding="utf-8")).get("revision")
    if not re.fullmatch(r"[0-9a-f]+", str(revision)):
        raise RunError(
            f"{job.run} must be begun at a revision with nothing uncommitted, got {revision!r}: train it again"
        )
    policy, evaluated = ((job.run / name).read_bytes() for name in (f"{BEST}/{POLICY}", EVALUATIONS))
    folder = checkpoints / job.row / f"seed-{job.config.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / EVALUATIONS, evaluated)
    write_atomically(folder / POLICY, policy)
    return folder
