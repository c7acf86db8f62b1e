"""Trains one run of each row again and compares it with the published runs: `make reproduce`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from agents.distillation.config import STUDENTS
from agents.evaluation.episodes import evaluate, failures, scores
from agents.evaluation.policies import checkpoint_names
from agents.evaluation.statistics import interquartile_mean
from agents.study.jobs import evaluations, plan, train_all
from agents.training.presets import LARGEST_SEED, ROWS, RunError, row_settings
from agents.training.signals import INTERRUPTED
from baselines.tables import text_table
from capsule_gym.command_line import Count, Positional, parse, refuse
from capsule_gym.evaluation_sets import load_set
from capsule_gym.parameters import check_count

PROG = "python -m agents.reproduce"
# Trained with reinforcement learning, or distilled from the optimum.
PUBLISHED = (*ROWS, *STUDENTS)
HEADER = ["row", "set", "published cm/s (runs)", "expected", "now", "failed", "one core (min)", "verdict"]


@dataclass(frozen=True)
class Args:
    """Trains one run of each row of the leaderboard with a new seed, and compares it with the published runs.

    The mean speed on the set `wide`, for a row that is trained on such plants, or else on `paper`, should lie in the
    95 % prediction interval of the published runs: one in twenty falls outside by chance. The same command resumes. The
    exit status is 1 if a run failed or is slower than its interval.

    Examples:
      python -m agents.reproduce
      python -m agents.reproduce direct-ppo --seed 101
    """

    rows: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Which of {', '.join(PUBLISHED)}.")] = (
        PUBLISHED
    )
    seed: Count = 100
    """Training seed; one that no published run has makes the comparison independent."""
    jobs: int | None = None
    """Number of runs in parallel; one per core by default."""
    runs: Path = Path("runs/reproduce")
    """Folder of the runs."""

    def check(self) -> None:
        """Checks names and ranges."""
        for row in self.rows:
            if row not in STUDENTS:
                row_settings(row)
        if self.seed > LARGEST_SEED:
            raise ValueError(f"--seed must be an integer >= 0 and <= {LARGEST_SEED}, got {self.seed}")
        if self.jobs is not None:
            check_count("--jobs", self.jobs)


def prediction_interval(values: Sequence[float]) -> tuple[float, float]:
    """The interval that holds one more value of the same normal distribution with a probability of 95 %.

    Args:
        values: independent ones; the interval of fewer than two is infinite.

    >>> low, high = prediction_interval([9.0, 10.0, 11.0])
    >>> round(high - 10.0, 2), round(10.0 - low, 2)
    (4.97, 4.97)
    """
    # Slow to import, and --help does not need it.
    from scipy.stats import t

    count = len(values)
    if count < 2:
        return -math.inf, math.inf
    half = float(t.ppf(0.975, count - 1)) * float(np.std(values, ddof=1)) * math.sqrt(1.0 + 1.0 / count)
    return float(np.mean(values)) - half, float(np.mean(values)) + half


def compare(row: str, run: Path, seconds: float) -> list[str]:
    """Evaluates a finished run and the published runs of its row; returns a line of the table.

    Args:
        row: its name.
        run: the run's folder.
        seconds: processor time of its training.
    """
    randomization = STUDENTS[row].randomization if row in STUDENTS else ROWS[row].randomization
    evaluation_set = load_set("wide" if randomization == "wide" else "paper")
    episodes = evaluate(run, evaluation_set)
    speed = float(interquartile_mean(scores(episodes, "mean_speed"))[0])
    known, expected, verdict = "", "", "no comparison"
    if row in checkpoint_names():
        published = interquartile_mean(scores(evaluate(row, evaluation_set), "mean_speed")).tolist()
        known = f"{min(published):.2f} to {max(published):.2f} ({len(published)})"
        if len(published) > 1:
            low, high = prediction_interval(published)
            expected = f"{low:.2f} to {high:.2f}"
            verdict = "below" if speed < low else "above" if speed > high else "within"
    failed = f"{failures(episodes)}/{len(episodes)}"
    return [row, evaluation_set.name, known, expected, f"{speed:.2f}", failed, f"{seconds / 60.0:.1f}", verdict]


def train(args: Args) -> tuple[list[list[str]], dict[str, str]]:
    """Trains the rows that are not finished; returns the lines of the table, and the reasons of failures by row.

    Raises:
        KeyboardInterrupt: if the user stops it.
    """
    # Slow to import, and --help does not need them.
    from agents.distillation.dagger import distil_all, read_result

    jobs = plan({row: row_settings(row) for row in args.rows if row not in STUDENTS}, [args.seed], args.runs)
    failed = {job.row: reason for job, reason in train_all(jobs, args.jobs).items()}
    lines = [
        compare(job.row, job.run, evaluations(job.run)[-1]["core_seconds"]) for job in jobs if job.row not in failed
    ]
    for row in (row for row in args.rows if row in STUDENTS):
        folder = args.runs / row / f"seed-{args.seed}"
        if not distil_all(row, {args.seed: folder}):
            raise KeyboardInterrupt
        result = read_result(folder)
        assert result is not None
        lines.append(compare(row, folder, result["core_seconds"]))
    return lines, failed


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        lines, failed = train(args)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print("\nStopped. The same command resumes.")
        return INTERRUPTED
    print(text_table([HEADER, *lines], left=1))
    print("\nexpected: the 95 % prediction interval of the published runs (normal, Student's t) for one more run.")
    for row, reason in failed.items():
        print(f"{row} failed: {reason}", file=sys.stderr)
    return 1 if failed or any(line[-1] == "below" for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
