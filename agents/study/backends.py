"""Where the runs of a study are trained: in processes of this machine, or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from agents.study.jobs import Job, Outcome
from agents.study.process import ATTEMPTS, ROOT, train_run

Backend = Literal["local", "ray"]
# Seconds between two chances for Ctrl-C.
PATIENCE = 0.5


def locally(jobs: Sequence[Job], parallel: int | None, stop: Path) -> Iterator[Outcome]:
    """Trains in processes of this machine.

    Args:
        jobs: the runs.
        parallel: how many at a time; None for as many as there are cores.
        stop: the file that tells them to stop.

    Yields:
        How each ended, in the order in which they end.
    """
    from joblib import Parallel, cpu_count, delayed

    # Each thread waits for the process of a run. Were the processes joblib's own, one that dies would end them all.
    pool = Parallel(parallel or cpu_count(), backend="threading", batch_size=1, return_as="generator_unordered")
    yield from pool(delayed(train_run)(job, stop) for job in jobs)


def on_ray(jobs: Sequence[Job], parallel: int | None, stop: Path) -> Iterator[Outcome]:
    """Trains on the Ray cluster that RAY_ADDRESS names, or on one of this machine that ends with the study.

    All its machines must have the checkout and the folder of the runs at the same place.

    Args:
        jobs: the runs.
        parallel: how many at a time; None for as many as there are cores.
        stop: the file that tells them to stop.

    Yields:
        How each ended, in the order in which they end.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    settings: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    if "RAY_ADDRESS" not in os.environ:
        settings |= {"num_cpus": parallel, "include_dashboard": False}
    ray.init(runtime_env={"env_vars": {"PYTHONPATH": str(ROOT)}}, **settings)
    try:
        # Ray itself begins a task again whose worker has died.
        task: Any = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(train_run)
        cores = int(ray.cluster_resources()["CPU"])
        left = iter(jobs)
        waiting: dict[Any, Job] = {}
        while True:
            free = max(0, (parallel or cores) - len(waiting))
            waiting |= {task.remote(job, stop.resolve()): job for job in islice(left, free)}
            if not waiting:
                return
            done, _ = ray.wait(list(waiting), timeout=PATIENCE)
            for reference in done:
                job = waiting.pop(reference)
                try:
                    yield ray.get(reference)
                except ray.exceptions.RayError as error:
                    yield Outcome(job, "failed", f"Ray: {str(error).splitlines()[0]}")
    finally:
        ray.shutdown()


BACKENDS: dict[Backend, Callable[[Sequence[Job], int | None, Path], Iterator[Outcome]]] = {
    "local": locally,
    "ray": on_ray,
}
