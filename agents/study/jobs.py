"""The runs of a study: one per row and training seed, each in its own folder, from which it can be resumed."""

import csv
import dataclasses
import json
import re
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

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
    """Lists the runs of a study: the first seed of every row, then the second, and so on.

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
            begun, now = read_config(job.run).to_dict(), job.config.to_dict()
            changed = [
                f"{name} was {begun.get(name)!r} and is {now[name]!r}" for name in now if begun.get(name) != now[name]
            ]
            if changed:
                raise RunError(f"{job.run} contains a run with other settings ({', '.join(changed)}): move it")
    return jobs


def train_job(job: Job) -> str:
    """Trains or resumes a run, with its output in seed-N.log next to its folder; returns the reason for a failure."""
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


def train_all(jobs: Sequence[Job], parallel: int | None = None, backend: str = "loky") -> dict[Job, str]:
    """Trains or resumes the unfinished runs, `parallel` at a time; returns the reasons for failures by run."""
    # Imported here, since it takes long.
    from joblib import Parallel, delayed

    waiting = [job for job in jobs if not job.finished]
    try:
        if backend == "ray" and waiting:
            found = _train_on_ray([dataclasses.replace(job, run=job.run.resolve()) for job in waiting])
        else:
            # One run per task, since joblib would otherwise batch several short runs.
            work = Parallel(parallel or -1, verbose=10, batch_size=1, pre_dispatch="n_jobs")
            found = work(delayed(train_job)(job) for job in waiting)
    except Exception as error:
        # `train_job` does not raise: a worker was killed.
        reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}; --resume continues"
        found = ["" if job.finished else reason for job in waiting]
    return {job: reason for job, reason in zip(waiting, found, strict=True) if reason}


def _train_on_ray(jobs: Sequence[Job]) -> list[str]:
    """Trains or resumes runs on the Ray cluster that RAY_ADDRESS names, or a new one; returns reasons for failures.

    All machines need the checkout and the runs at the same paths. Ray resumes the runs of a lost machine on another
    one; joblib's backend for Ray would wait forever for it, whose actor holds its place.
    """
    import ray

    root = str(Path(__file__).resolve().parents[2])
    ray.init(runtime_env={"env_vars": {"PYTHONPATH": root}}, log_to_driver=False, logging_level="error")
    try:
        # Ray starts as many as it has processors.
        task = ray.remote(num_cpus=1, max_retries=-1)(train_job)
        references = running = [task.remote(job) for job in jobs]
        for _ in tqdm(jobs, unit=" runs", disable=None):
            _, running = ray.wait(running)
        found: list[str] = ray.get(references)
        return found
    finally:
        ray.shutdown()


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
    """Copies a run's best policy and its evaluations into the folder of its row and seed, which it returns.

    Raises:
        RunError: if the run is not finished, or its code was not committed.
    """
    if not job.finished:
        raise RunError(f"{job.run} is not finished")
    revision = json.loads((job.run / CONFIG).read_text(encoding="utf-8")).get("revision")
    if not re.fullmatch(r"[0-9a-f]+", str(revision)):
        raise RunError(f"{job.run} must be a run of committed code, got the revision {revision!r}: train it again")
    folder = checkpoints / job.row / f"seed-{job.config.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    for path in (job.run / EVALUATIONS, job.run / BEST / POLICY):
        write_atomically(folder / path.name, path.read_bytes())
    return folder
