"""Trains rows of the leaderboard over training seeds: `python -m agents.study`.

A study has one run per row and seed, each in its own folder, from which it can be resumed.
"""

import csv
import dataclasses
import json
import re
import signal
import sys
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import product
from multiprocessing import active_children
from pathlib import Path
from types import FrameType
from typing import Annotated, Literal

from tqdm import tqdm

from agents.criteria import CRITERIA
from agents.training.config import BEST, CONFIG, EVALUATIONS, Config, RunError, read_config
from agents.training.presets import TRAINED_ROWS, row_settings
from agents.training.signals import INTERRUPTED, SIGNALS, Stop
from baselines.tables import text_table
from capsule_gym.checks import check_count
from capsule_gym.command_line import Positional, arg, command
from capsule_gym.evaluation.candidates import CHECKPOINTS
from capsule_gym.files import write_atomically
from capsule_gym.policies.policy import POLICY

# Written into a run's folder when its training is complete.
FINISHED = "finished"


@dataclass(frozen=True)
class Job:
    """One run of a study.

    Attributes:
        row: row of the leaderboard.
        config: settings of the row, with the training seed.
        run: folder of the run.
    """

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
    """Lists the runs of a study, each once: the first seed of every row, then the second, ..

    Raises:
        RunError: if a run's folder exists and holds no run, or a run with other settings.
        ValueError: if a row does not exist, or a seed is out of range.
    """
    jobs = []
    for seed, row in product(dict.fromkeys(seeds), dict.fromkeys(rows)):
        config = dataclasses.replace(row_settings(row), seed=seed)
        jobs.append(Job(row, config, folder / row / f"seed-{seed}"))
    for job in jobs:
        job.config.check()
        if job.run.exists():
            _check_settings(job)
    return jobs


def _check_settings(job: Job) -> None:
    """Raises a RunError for a run that has begun with other settings."""
    begun = read_config(job.run).to_dict()
    changed = []
    for name, now in job.config.to_dict().items():
        if begun.get(name) != now:
            changed.append(f"{name} was {begun.get(name)!r} and is {now!r}")
    if changed:
        reason = f"contains a run with other settings ({', '.join(changed)})"
        raise RunError(f"{job.run} {reason}: move it")


class StopWorkers(Stop):
    """Passes SIGTERM on to the workers, which get the terminal's Ctrl-C themselves."""

    def _request(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTERM:
            for worker in active_children():
                worker.terminate()
        super()._request(number, frame)


def _ignore_signals() -> None:
    """Lets a worker without a run outlive the signals that stop the others."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def train_job(job: Job) -> str:
    """Trains or resumes a run, with its output in seed-N.log next to its folder.

    Returns:
        The reason for a failure; empty if the run is complete.
    """
    path = job.run.with_name(f"{job.run.name}.log")
    path.parent.mkdir(parents=True, exist_ok=True)
    log = path.open("a", encoding="utf-8", buffering=1)
    with log, redirect_stdout(log), redirect_stderr(log), Stop() as stop:
        # Imported here, since torch takes seconds to import and only workers need it.
        from agents.training.loop import begin, train

        try:
            if not job.run.exists():
                begin(job.run, job.config)
            if stop.requested or not train(job.run):
                return "stopped by a signal"
            (job.run / FINISHED).touch()
        except Exception as error:
            traceback.print_exc()
            return f"{error} (see {path})"
    return ""


def train_all(
    jobs: Sequence[Job], parallel: int | None = None, backend: str = "loky"
) -> dict[Job, str]:
    """Trains or resumes the unfinished runs, `parallel` at a time.

    Returns:
        The reasons for failures by run.
    """
    # Imported here, since it takes long.
    from joblib import Parallel, delayed

    waiting = [job for job in jobs if not job.finished]
    try:
        if backend == "ray" and waiting:
            reasons = _train_on_ray(waiting)
        else:
            work = Parallel(
                parallel or -1,
                verbose=10,
                # joblib would otherwise put several short runs into one batch.
                batch_size=1,
                pre_dispatch="n_jobs",
                initializer=_ignore_signals,
            )
            with StopWorkers() as stop:
                reasons = work(delayed(train_job)(job) for job in waiting if not stop.requested)
            if stop.requested:
                raise KeyboardInterrupt
    except Exception as error:
        # `train_job` does not raise: a worker was killed.
        message = str(error).partition("\n")[0]
        reason = f"{type(error).__name__}: {message}; --resume continues"
        reasons = ["" if job.finished else reason for job in waiting]
    return {job: reason for job, reason in zip(waiting, reasons, strict=True) if reason}


def _train_on_ray(jobs: Sequence[Job]) -> list[str]:
    """Trains or resumes runs on the Ray cluster that RAY_ADDRESS names, or a new one.

    Returns the reasons for failures, as `train_job`.

    All machines need the checkout and the runs at the same paths. Ray resumes the runs of a lost
    machine on another one; joblib's backend for Ray would wait forever for it, whose actor holds
    its place.
    """
    import ray

    root = str(Path(__file__).resolve().parents[1])
    environment = {"env_vars": {"PYTHONPATH": root}}
    ray.init(runtime_env=environment, log_to_driver=False, logging_level="error")
    try:
        # Ray starts as many as it has processors.
        train_remotely = ray.remote(num_cpus=1, max_retries=-1)(train_job)
        references = []
        for job in jobs:
            absolute = dataclasses.replace(job, run=job.run.resolve())
            references.append(train_remotely.remote(absolute))
        running = references
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
        path = job.run / EVALUATIONS
        if not path.is_file():
            continue
        evaluations = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
        criteria = CRITERIA[job.config.task]
        best = max(evaluations, key=lambda row: float(row[f"score_{criteria.suffix}"]))
        # The column of the task's metric has its unit in its name; further terms of the score have
        # none, and are missing in older files.
        metrics = {name: float(best[name]) for name in criteria.weights if name in best}
        metrics[criteria.metric.name] = float(best[criteria.column])
        steps = [f"{int(row['steps']):,}" for row in (evaluations[-1], best)]
        rows.append([job.name, *steps, criteria.describe(metrics)])
    return text_table(rows, left=1)


def check_committed(job: Job) -> None:
    """Raises a RunError for a run that has begun, or would begin now, with uncommitted code."""
    # Imported here, since it needs torch.
    from agents.training.checkpoint import git_revision

    path = job.run / CONFIG
    revision = git_revision()
    if path.exists():
        revision = json.loads(path.read_text(encoding="utf-8")).get("revision")
    if not re.fullmatch(r"[0-9a-f]+", str(revision)):
        found = f"the revision {revision!r} of {job.run}"
        raise RunError(f"--publish needs runs of committed code, got {found}")


def copy_policy(job: Job, checkpoints: Path = CHECKPOINTS) -> Path:
    """Copies a run's best policy and its evaluations into the folder of its row and seed.

    Returns that folder. The run's configuration replaces that of the row, whose runs differ in
    their seeds only.

    Raises:
        RunError: if the run is not finished, or its code was not committed.
    """
    if not job.finished:
        raise RunError(f"{job.run} is not finished")
    check_committed(job)
    folder = checkpoints / job.row / f"seed-{job.config.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    for path in (job.run / EVALUATIONS, job.run / BEST / POLICY):
        write_atomically(folder / path.name, path.read_bytes())
    write_atomically(folder.with_name(CONFIG), (job.run / CONFIG).read_bytes())
    return folder


@command("python -m agents.study", OSError, ValueError)
def main(
    rows: Annotated[
        Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Rows: {', '.join(TRAINED_ROWS)}.")
    ],
    seeds: Annotated[tuple[int, ...], arg(metavar="N")] = tuple(range(10)),
    jobs: int | None = None,
    backend: Literal["loky", "ray"] = "loky",
    runs: Path = Path("runs/study"),
    resume: bool = False,
    publish: bool = False,
) -> int:
    """Trains rows of the leaderboard over training seeds, several runs in parallel.

    Ctrl-C or SIGTERM stops; finished runs stay as they are, and --resume continues the others from
    their last checkpoint. A run that fails does not stop the others; the exit status is then 1.

    Examples:
      python -m agents.study direct-ppo residual-ppo --seeds {0..4} 7 --jobs 4
      python -m agents.study direct-ppo --resume --publish

    Args:
        rows: rows.
        seeds: Training seeds.
        jobs: Number of runs in parallel with loky; one per core by default. Ray starts one per
            processor of the cluster.
        backend: joblib's processes of this machine, or the Ray cluster that RAY_ADDRESS names
            (extra `cluster`).
        runs: Folder of the runs, each in NAME/seed-N with its output in NAME/seed-N.log; a cluster
            must share it.
        resume: Continue unfinished runs of your own: checkpoints contain pickles, which can run any
            code.
        publish: Copy the policies of finished runs to capsule_gym/data/policies, for the
            leaderboard.
    """
    if not rows:
        raise ValueError(f"NAME must be one or several of {', '.join(TRAINED_ROWS)}")
    if jobs is not None:
        check_count("--jobs", jobs)
        if backend == "ray":
            raise ValueError("--jobs needs --backend loky")
    if backend == "ray" and find_spec("ray") is None:
        raise ValueError("--backend ray needs Ray: pip install 'capsule-gym[cluster]'")
    planned = plan(rows, seeds, runs)
    for job in planned:
        if job.run.exists() and not job.finished and not resume:
            hint = "--resume continues what is your own, reading the pickles of its checkpoints"
            raise ValueError(f"{job.run} contains an unfinished run: {hint}")
        if publish and not job.finished:
            check_committed(job)
    try:
        failures = train_all(planned, jobs, backend)
    except KeyboardInterrupt:
        print("\nStopped; --resume continues.")
        return INTERRUPTED
    print(results_table(planned))
    plants = "the run's validation plants, never on a frozen set"
    print(f"Mean speed and failures of the best evaluation on {plants}.")
    problems = [f"{job.name} failed: {reason}" for job, reason in failures.items()]
    if publish:
        problems += _publish(planned)
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


def _publish(jobs: Sequence[Job]) -> list[str]:
    """Publishes finished runs; returns the reasons why some are not."""
    problems = []
    for job in jobs:
        if job.finished:
            try:
                print(f"Published: {copy_policy(job)}")
            except (RunError, OSError) as error:
                problems.append(f"{job.name} is not published: {error}")
    return problems


if __name__ == "__main__":
    sys.exit(main())
