"""What a study consists of: one run per row and training seed, and where each of them stands."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agents.training.errors import RunError
from agents.training.presets import (
    CONFIG,
    EVALUATED,
    EVALUATIONS,
    LARGEST_SEED,
    Config,
    read_config,
    row_settings,
)
from capsule_gym.files import to_json, write_atomically

# Written into a run's folder once its training has come to its end.
FINISHED = "finished.json"

State = Literal["finished", "stopped", "failed"]


@dataclass(frozen=True)
class Job:
    """One run of a study.

    Attributes:
        row: its row of the leaderboard.
        config: what it is trained with, its seed included.
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
        """Whether it has been trained to its end."""
        return (self.run / FINISHED).is_file()


@dataclass(frozen=True)
class Outcome:
    """How an attempt to train a run ended.

    Attributes:
        job: the run.
        state: finished; stopped, with a checkpoint to go on from; or failed.
        reason: why it failed.
    """

    job: Job
    state: State
    reason: str = ""


@dataclass(frozen=True)
class Evaluation:
    """A line of a run's evaluations.csv: its deterministic policy on plants of its own draws.

    Attributes:
        steps: agent steps until then.
        seconds: of training until then.
        core_seconds: of processor time until then; None of runs that did not count it.
        mean_speed: interquartile mean, cm/s.
        failed: share of the episodes that failed.
        score: what the run's best policy is chosen by, cm/s.
        stage: of the run, from 0 on; what comes of a run is of its last.
    """

    steps: int
    seconds: float
    mean_speed: float
    failed: float
    score: float
    stage: int
    core_seconds: float | None = None


def seeds_of(words: Sequence[str], option: str = "--seeds") -> list[int]:
    """Training seeds out of the words of a command line, in order and each once.

    Args:
        words: seeds, and ranges of them.
        option: where they stand, for the error.

    Raises:
        ValueError: if a word is neither a seed nor a range of them.

    >>> seeds_of(["0-2", "7"])
    [0, 1, 2, 7]
    """
    seeds: set[int] = set()
    for word in words:
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", word)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if not first <= last <= LARGEST_SEED:
            raise ValueError(f"{option} must be integers and ranges such as 0-9 up to {LARGEST_SEED}, got {word!r}")
        seeds.update(range(first, last + 1))
    return sorted(seeds)


def plan(rows: Iterable[str], seeds: Sequence[int], folder: Path) -> list[Job]:
    """The runs of a study, seed by seed, so that all rows have their first seeds first.

    Args:
        rows: names of `ROWS`.
        seeds: training seeds.
        folder: of all of them; a run is in NAME/seed-N.

    Raises:
        RunError: if a folder is there and holds no run, or one of other settings.
        ValueError: if there is no such row.
    """
    return plan_of({row: row_settings(row) for row in rows}, seeds, folder)


def plan_of(settings: Mapping[str, Config], seeds: Sequence[int], folder: Path) -> list[Job]:
    """As `plan`, of any settings.

    Args:
        settings: what is trained, by name.
        seeds: training seeds.
        folder: of all runs.

    Raises:
        RunError: as for `plan`.
    """
    jobs = [
        Job(row, dataclasses.replace(config, seed=seed), folder / row / f"seed-{seed}")
        for seed in seeds
        for row, config in settings.items()
    ]
    for job in jobs:
        if job.run.exists():
            refuse_other_settings(job)
    return jobs


def refuse_other_settings(job: Job) -> None:
    """Refuses a run that was begun with other settings than its row has now.

    Raises:
        RunError: if it was, or its folder is broken.
    """
    # As JSON, which knows no tuples.
    begun, now = (json.loads(to_json(config.to_dict())) for config in (read_config(job.run), job.config))
    changed = [f"{name} was {begun.get(name)!r} and is {now[name]!r}" for name in now if begun.get(name) != now[name]]
    if changed:
        raise RunError(f"{job.run} holds a run of other settings ({', '.join(changed)}): move it elsewhere")


def revision_of(run: Path) -> str:
    """The git revision that a run was begun at."""
    return str(json.loads((run / CONFIG).read_text(encoding="utf-8")).get("revision"))


def evaluations(run: Path) -> list[Evaluation]:
    """What a run has evaluated so far; nothing where it has not begun."""
    try:
        with (run / EVALUATIONS).open(encoding="utf-8", newline="") as file:
            # The last line may be under way.
            rows = [row for row in csv.DictReader(file) if None not in row.values()]
    except FileNotFoundError:
        return []
    return [
        Evaluation(
            steps=int(row[EVALUATED]),
            seconds=float(row["seconds"]),
            mean_speed=float(row["mean_speed_cm_s"]),
            failed=float(row["failed"]),
            score=float(row["score_cm_s"]),
            stage=int(row["stage"]),
            core_seconds=float(row["core_seconds"]) if "core_seconds" in row else None,
        )
        for row in rows
    ]


def best(lines: Sequence[Evaluation], config: Config) -> Evaluation | None:
    """The evaluation whose policy a run has come to; None where its last stage has none yet."""
    last = len(config.stages()) - 1
    return max((line for line in lines if line.stage == last), key=lambda line: line.score, default=None)


def note_end(run: Path) -> None:
    """Writes down that a run has been trained to its end."""
    last = evaluations(run)[-1]
    write_atomically(run / FINISHED, to_json({"steps": last.steps, "seconds": last.seconds}))
