"""Trains rows of the leaderboard over training seeds: `python -m agents.study --help`."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

from agents.study.jobs import plan, publish, results_table, train_all
from agents.training.config import RunError
from agents.training.presets import ROWS
from agents.training.signals import INTERRUPTED
from capsule_gym.checks import check_count
from capsule_gym.command_line import Positional, arg, parse, refuse

PROG = "python -m agents.study"


@dataclass(frozen=True)
class Args:
    """Trains rows of the leaderboard over training seeds, several runs in parallel.

    Ctrl-C stops; finished runs stay as they are, and --resume continues the others from their last checkpoint. A run
    that fails does not stop the others; the exit status is then 1.

    Examples:
      python -m agents.study direct-ppo residual-ppo --seeds {0..4} 7 --jobs 4
      python -m agents.study direct-ppo --resume --publish
    """

    rows: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Rows: {', '.join(ROWS)}.")]
    seeds: Annotated[tuple[int, ...], arg(metavar="N")] = tuple(range(10))
    """Training seeds."""
    jobs: int | None = None
    """Number of runs in parallel with loky; one per core by default. Ray starts one per processor of the cluster."""
    backend: Literal["loky", "ray"] = "loky"
    """joblib's processes of this machine, or the Ray cluster that RAY_ADDRESS names (extra `cluster`)."""
    runs: Path = Path("runs/study")
    """Folder of the runs, each in NAME/seed-N with its output in NAME/seed-N.log; a cluster must share it."""
    resume: bool = False
    """Continue unfinished runs of your own: checkpoints contain pickles, which can run any code."""
    publish: bool = False
    """Copy the policies of finished runs to agents/checkpoints, for the leaderboard."""

    def check(self) -> None:
        """Checks names and ranges."""
        if not self.rows:
            raise ValueError(f"NAME must be one or several of {', '.join(ROWS)}")
        for job in plan(self.rows, self.seeds, self.runs):
            if job.run.exists() and not job.finished and not self.resume:
                raise ValueError(
                    f"{job.run} contains an unfinished run: --resume continues what is your own, reading the pickles "
                    "of its checkpoints"
                )
        if self.jobs is not None:
            check_count("--jobs", self.jobs)
            if self.backend == "ray":
                raise ValueError("--jobs needs --backend loky")
        if self.backend == "ray" and find_spec("ray") is None:
            raise ValueError("--backend ray needs Ray: pip install 'capsule-gym[cluster]'")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        jobs = plan(args.rows, args.seeds, args.runs)
        failures = train_all(jobs, args.jobs, args.backend)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print("\nStopped; --resume continues.")
        return INTERRUPTED
    print(results_table(jobs))
    print("Mean speed and failures of the best evaluation on the run's validation plants, never on a frozen set.")
    problems = [f"{job.name} failed: {reason}" for job, reason in failures.items()]
    for job in (job for job in jobs if args.publish and job.finished):
        try:
            print(f"Published: {publish(job)}")
        except (RunError, OSError) as error:
            problems.append(f"{job.name} is not published: {error}")
    print(*problems, sep="\n", end="\n" if problems else "", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
