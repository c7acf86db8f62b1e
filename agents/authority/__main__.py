"""Trains agents with more or less authority over a law, and shows what it is worth: `python -m agents.authority`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tqdm import tqdm
from tyro.conf import arg

from agents.authority.design import SEEDS, STEPS, all_arms, plan
from agents.authority.figure import draw
from agents.authority.page import COMMAND, render
from agents.authority.results import RESULTS, Results, gather, judge, laws_alone, load, save
from agents.study.jobs import Job, seeds_of
from agents.study.study import check_jobs, leave, tell_failures, train_all
from agents.training.errors import RunError
from agents.training.stopping import INTERRUPTED
from baselines.drawing import save as save_figure
from baselines.drawing import style
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.files import write_atomically

ROOT = Path(__file__).resolve().parents[2]
RUNS = Path("runs/authority")
DOCS = Path("docs")
TABLES = "when_a_law_helps_tables.md"
FIGURE = "authority"


@dataclass(frozen=True)
class Options:
    """Trains agents on several laws, with more or less torque of their own, and compares them on plants of own draws.

    Called again, it goes on. Ctrl-C saves and stops. Nothing is published before every run is finished.

    Examples:
      python -m agents.authority --jobs 2
      python -m agents.authority --publish            also write the results, the tables and the figure
      python -m agents.authority --from-results       write tables and figure of the committed results
    """

    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = (f"{SEEDS[0]}-{SEEDS[-1]}",)
    """Training seeds, and ranges of them such as 0-9."""
    total_steps: Count = STEPS
    """Environment steps of each run."""
    jobs: int | None = None
    """Runs that are trained at a time; as many as there are cores."""
    runs: Path = RUNS
    """Folder of the runs."""
    publish: bool = False
    """Write agents/authority/results.json, docs/when_a_law_helps_tables.md and docs/figures/authority.png."""
    from_results: bool = False
    """Train nothing: write the tables and the figure of the results that are there."""

    def check(self) -> None:
        """Refuses numbers out of range."""
        if self.total_steps < 1:
            raise ValueError(f"--total-steps must be an integer >= 1, got {self.total_steps}")
        seeds_of(self.seeds)
        check_jobs(self.jobs)


def write_docs(results: Results, folder: Path) -> None:
    """Writes the tables and the figure into the folder of the documentation."""
    with style():
        save_figure(draw(results), folder / "figures" / FIGURE)
    write_atomically(folder / TABLES, render(results))


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    if options.from_results:
        try:
            write_docs(load(), root / DOCS)
        except ValueError as error:
            refuse(COMMAND, str(error))
        return 0
    try:
        jobs = plan(all_arms(), seeds_of(options.seeds), options.total_steps, options.runs)
        outcomes = train_all(list(jobs), options.runs, options.jobs)
    except (RunError, OSError) as error:
        refuse(COMMAND, str(error))
    finished: list[Job] = [outcome.job for outcome in outcomes if outcome.state == "finished"]
    arms = [jobs[job] for job in finished]
    judged = [judge(job, jobs[job]) for job in tqdm(finished, "evaluating", file=sys.stderr, disable=None)]
    results = gather([*laws_alone(arms), *judged], options.total_steps)
    if options.publish and len(finished) == len(jobs):
        save(results, root / RESULTS.relative_to(ROOT))
        write_docs(results, root / DOCS)
    if finished:
        print(render(results))
    tell_failures(outcomes)
    if any(outcome.state == "stopped" for outcome in outcomes):
        print("Stopped; saved. The same command goes on.")
        return INTERRUPTED
    return 0 if len(finished) == len(jobs) else 1


if __name__ == "__main__":
    leave(main)
