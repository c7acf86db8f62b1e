"""Trains one run of each row anew and says whether it is what the published runs let expect: `make reproduce`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from agents.distil.students import STUDENTS
from agents.evaluation.episodes import evaluate, failures, scores
from agents.evaluation.policies import checkpoint_names
from agents.evaluation.statistics import interquartile_mean
from agents.study.jobs import Job, Outcome, evaluations, plan
from agents.study.progress import brief
from agents.study.study import check_jobs, leave, tell_failures, train_all
from agents.training.errors import RunError
from agents.training.presets import LARGEST_SEED, ROWS, row_settings
from agents.training.stopping import INTERRUPTED
from baselines.tables import text_table
from capsule_gym.command_line import Count, Positional, parse, refuse
from capsule_gym.evaluation_sets import load_set

PROG = "python -m agents.reproduce"
RUNS = Path("runs/reproduce")
# A seed that no published run has.
SEED = 100
# What learnt from reward, and what the optimum taught.
PUBLISHED = (*ROWS, *(name for name, student in STUDENTS.items() if not student.told))
# Student's t at 97.5 % with 1, 2, .. degrees of freedom; with more than these the last, which is on the safe side.
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)


@dataclass(frozen=True)
class Options:
    """Trains one run of each row of the leaderboard anew, with a seed of its own, and compares it with the published.

    The mean speed on the set `wide`, where a row is trained on such plants, or else on `paper`, should lie within the
    95 % prediction interval of the published runs: one in twenty falls outside by chance. Called again, it goes on with
    what is not finished. The exit status is 1 if a run failed or is slower than its interval.

    Examples:
      python -m agents.reproduce
      python -m agents.reproduce direct-ppo --seed 101
    """

    rows: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Which of {', '.join(PUBLISHED)}.")] = (
        PUBLISHED
    )
    seed: Count = SEED
    """Training seed; one that is not among the published runs' is a test of its own."""
    jobs: int | None = None
    """Runs that are trained at a time; as many as there are cores."""
    runs: Path = RUNS
    """Folder of the runs."""

    def check(self) -> None:
        """Refuses rows and seeds that do not exist."""
        for row in self.rows:
            if row not in STUDENTS:
                row_settings(row)
        if self.seed > LARGEST_SEED:
            raise ValueError(f"--seed must be an integer >= 0 and <= {LARGEST_SEED}, got {self.seed}")
        check_jobs(self.jobs)


def prediction_interval(values: Sequence[float]) -> tuple[float, float]:
    """Where one more value of the same normal distribution lies with a probability of 95 %.

    Args:
        values: independent ones; of a single value nothing follows, and the interval is infinite.

    >>> low, high = prediction_interval([9.0, 10.0, 11.0])
    >>> round(high - 10.0, 2), round(10.0 - low, 2)
    (4.97, 4.97)
    """
    count = len(values)
    if count < 2:
        return -math.inf, math.inf
    student = STUDENT[min(count - 1, len(STUDENT)) - 1]
    half = student * float(np.std(values, ddof=1)) * math.sqrt(1.0 + 1.0 / count)
    mean = float(np.mean(values))
    return mean - half, mean + half


@dataclass(frozen=True)
class Verdict:
    """A run that was trained anew beside the published ones of its row.

    Attributes:
        row: its name.
        set: what it was evaluated on.
        speed: interquartile mean, cm/s.
        failed: failures over episodes, as text.
        published: the same mean speed of every published run.
        seconds: of processor time that it took to train.
    """

    row: str
    set: str
    speed: float
    failed: str
    published: tuple[float, ...]
    seconds: float

    @property
    def words(self) -> str:
        """Where the speed lies."""
        low, high = prediction_interval(self.published)
        if math.isinf(low):
            return f"{len(self.published)} published: nothing to compare with"
        return "below" if self.speed < low else "above" if self.speed > high else "within"

    def cells(self) -> list[str]:
        """A line of the table."""
        low, high = prediction_interval(self.published)
        expected = "" if math.isinf(low) else f"{low:.2f} to {high:.2f}"
        count = len(self.published)
        shown = f"{min(self.published):.2f} to {max(self.published):.2f} ({count})" if count else ""
        speed = f"{self.speed:.2f}"
        return [self.row, self.set, shown, expected, speed, self.failed, brief(self.seconds), self.words]


HEADER = ["row", "set", "published cm/s (runs)", "expected", "now", "failed", "training (one core)", "verdict"]


def set_of(row: str) -> str:
    """The frozen set that is drawn as a row's training episodes are."""
    trained_on = STUDENTS[row].randomization if row in STUDENTS else ROWS[row].randomization
    return "wide" if trained_on == "wide" else "paper"


def judge(row: str, run: Path, seconds: float) -> Verdict:
    """Evaluates a finished run and the published ones of its row on a frozen set.

    Args:
        row: its name.
        run: the run's folder.
        seconds: of processor time that it took to train.
    """
    set_name = set_of(row)
    evaluation_set = load_set(set_name)
    episodes = evaluate(run, evaluation_set)
    published: tuple[float, ...] = ()
    if row in checkpoint_names():
        speeds = scores(evaluate(row, evaluation_set), "mean_speed")
        published = tuple(float(speed) for speed in interquartile_mean(speeds))
    return Verdict(
        row,
        set_name,
        float(interquartile_mean(scores(episodes, "mean_speed"))[0]),
        f"{failures(episodes)}/{len(episodes)}",
        published,
        seconds,
    )


def train(options: Options) -> tuple[list[Outcome], list[Verdict], bool]:
    """Trains what is not finished: first what learns from reward, then students, one after the other.

    Returns:
        How each run ended that learns from reward, verdicts on what is finished, and whether all was, or failed.
    """
    # Not needed to say what there is to reproduce, and slow to import.
    from agents.distil.outcome import teach
    from agents.distil.run import read_result

    jobs = plan([row for row in options.rows if row not in STUDENTS], [options.seed], options.runs)
    outcomes = train_all(jobs, options.runs, options.jobs)
    ended = all(outcome.state != "stopped" for outcome in outcomes)
    finished = [outcome.job for outcome in outcomes if outcome.state == "finished"]
    verdicts = [judge(job.row, job.run, _core_seconds(job)) for job in finished] if ended else []
    for row in [row for row in options.rows if row in STUDENTS]:
        folder = options.runs / row / f"seed-{options.seed}"
        ended = ended and teach(row, {options.seed: folder}, STUDENTS[row].budget)
        result = read_result(folder)
        if ended and result:
            verdicts.append(judge(row, folder, result.core_seconds))
    return outcomes, verdicts, ended


def _core_seconds(job: Job) -> float:
    """The processor time of a run; the wall clock's where it did not count it."""
    last = evaluations(job.run)[-1]
    return last.seconds if last.core_seconds is None else last.core_seconds


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    began = time.monotonic()
    try:
        outcomes, verdicts, ended = train(options)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    if not ended:
        print("Stopped; saved. The same command goes on.")
        return INTERRUPTED
    print(text_table([HEADER, *(verdict.cells() for verdict in verdicts)], left=1))
    print("\nexpected: the 95 % prediction interval of the published runs (normal, Student's t) for one more run.")
    spent = sum(verdict.seconds for verdict in verdicts)
    print(f"Training took {brief(spent)} of processor time; all of it, {brief(time.monotonic() - began)} by the clock.")
    tell_failures(outcomes)
    return 1 if len(verdicts) < len(options.rows) or any(verdict.words == "below" for verdict in verdicts) else 0


if __name__ == "__main__":
    leave(main)
