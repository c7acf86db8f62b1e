"""Trains rows of the leaderboard over seeds, side by side: `python -m agents.study --help` says all."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.study.backends import Backend
from agents.study.jobs import plan, seeds_of
from agents.study.publication import publish
from agents.study.study import check_jobs, leave, tell, train_all
from agents.training.errors import RunError
from agents.training.presets import ROWS, row_settings
from agents.training.stopping import INTERRUPTED
from capsule_gym.command_line import Positional, parse, refuse

PROG = "python -m agents.study"
RUNS = Path("runs/study")


@dataclass(frozen=True)
class Options:
    """Trains rows of the leaderboard over training seeds, side by side; called again, it goes on.

    What is finished stays as it is, what is not goes on from its last checkpoint. Ctrl-C saves and stops. A run that
    fails stops no other; the exit status is then 1.

    Examples:
      python -m agents.study direct-ppo --seeds 0-9
      python -m agents.study direct-ppo residual-ppo --seeds 0-4 7 --jobs 4
      python -m agents.study direct-ppo --seeds 0-9 --publish
    """

    rows: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Which of {', '.join(ROWS)}.")]
    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-9",)
    """Training seeds, and ranges of them such as 0-9."""
    jobs: int | None = None
    """Runs that are trained at a time; as many as there are cores."""
    backend: Backend = "local"
    """Processes of this machine, or the Ray cluster that RAY_ADDRESS names (needs the extra `cluster`)."""
    runs: Path = RUNS
    """Folder of the runs, each in NAME/seed-N; a cluster must share it."""
    publish: bool = False
    """Copy the policies of finished runs to agents/checkpoints, for the leaderboard."""

    def check(self) -> None:
        """Refuses rows that do not exist, and numbers out of range."""
        if not self.rows:
            raise ValueError(f"NAME must be one or several of {', '.join(ROWS)}")
        for row in self.rows:
            row_settings(row)
        seeds_of(self.seeds)
        check_jobs(self.jobs)
        if self.backend == "ray" and find_spec("ray") is None:
            raise ValueError("--backend ray needs Ray: pip install 'capsule-gym[cluster]'")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    try:
        jobs = plan(options.rows, seeds_of(options.seeds), options.runs)
        outcomes = train_all(jobs, options.runs, options.jobs, options.backend)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    tell(outcomes)
    failed = any(outcome.state == "failed" for outcome in outcomes)
    if options.publish:
        for job in (outcome.job for outcome in outcomes if outcome.state == "finished"):
            try:
                print(f"Published: {publish(job)}")
            except (RunError, OSError) as error:
                print(f"Not published: {error}", file=sys.stderr)
                failed = True
    if any(outcome.state == "stopped" for outcome in outcomes):
        print("Stopped; saved. The same command goes on.")
        return INTERRUPTED
    return 1 if failed else 0


if __name__ == "__main__":
    leave(main)
