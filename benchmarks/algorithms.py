"""What each algorithm's preset learns of the direct task in the same time: `python -m benchmarks.algorithms`.

Runs are trained through `agents.study`, so that a comparison that is interrupted goes on when it is called again. A
run's best policy is chosen on its own draws; the frozen set is looked at once, at the end.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from tyro.conf import arg

from agents.evaluation.episodes import Episode, evaluate, summarise
from agents.evaluation.sets import EvaluationSet, load_set
from agents.evaluation.tables import MEASURES
from agents.study.jobs import Job, best, evaluations, plan_of, seeds_of
from agents.study.study import check_jobs, leave, tell_failures, train_all
from agents.training.errors import RunError
from agents.training.presets import PRESETS, Algorithm, Config
from agents.training.stopping import INTERRUPTED
from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, section
from benchmarks.trainers import PACKAGES
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.parameters import check_number

COMMAND = "python -m benchmarks.algorithms"
RUNS = Path("runs/algorithms")
ALGORITHMS: tuple[Algorithm, ...] = get_args(Algorithm)
SPEED, TRANSPORT = MEASURES["mean_speed"], MEASURES["cost_of_transport"]
HEADER = [
    "algorithm",
    "seeds",
    "mean speed (cm/s) [95 %]",
    "failures",
    "cost of transport [95 %]",
    "own draws (cm/s)",
    "steps",
    "steps/s",
    "minutes of one core",
]


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """Trains the preset of every algorithm on the direct task and compares what they have learnt.

    Ctrl-C saves and stops; the same command goes on.

    Examples:
      python -m benchmarks.algorithms --markdown docs/algorithms_tables.md
      python -m benchmarks.algorithms ppo sac --seeds 0 --part 0.5
    """

    algorithms: Annotated[Positional[tuple[Algorithm, ...]], arg(metavar="ALGORITHM")] = ALGORITHMS
    """Which of them; all where none is named."""
    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-2",)
    """Training seeds, and ranges of them such as 0-9."""
    part: float = 1.0
    """Part of the preset's environment steps that is trained."""
    jobs: int | None = None
    """Runs that are trained at a time; as many as there are cores."""
    set: str = "paper"
    """Evaluation set, by its name or its path."""
    runs: Path = RUNS
    """Folder of the runs, each in PRESET-STEPS/seed-N."""

    def check(self) -> None:
        """Refuses what cannot be trained, evaluated or written."""
        super().check()
        seeds_of(self.seeds)
        check_jobs(self.jobs)
        check_number("--part", self.part, "a finite number > 0", 0.0, open_low=True)
        load_set(self.set)


def settings_of(algorithm: Algorithm, part: float) -> Config:
    """The preset of an algorithm for the direct task, trained for a part of its steps."""
    preset = PRESETS["direct", algorithm]
    lengths = {name: max(1, round(part * getattr(preset, name))) for name in ("total_steps", "evaluate_every")}
    return dataclasses.replace(preset, **lengths)


def result_of(jobs: Sequence[Job], evaluation_set: EvaluationSet) -> dict[str, Any]:
    """What the finished runs of an algorithm have learnt and cost.

    Args:
        jobs: its runs.
        evaluation_set: what their best policies run on, once.

    Returns:
        The summary of their episodes, and per run its steps, its processor time and its best speed on its own draws.
    """
    # Imports torch.
    from agents.training.recurrent import load_best

    episodes: list[Episode] = []
    runs = []
    for job in jobs:
        seed, lines = job.config.seed, evaluations(job.run)
        chosen = best(lines, job.config)
        assert chosen is not None
        played = evaluate(load_best(job.run), evaluation_set)
        episodes += [{**episode, "training_seed": seed} for episode in played]
        runs.append(
            {
                "seed": seed,
                "steps": lines[-1].steps,
                "core_seconds": lines[-1].core_seconds,
                "mean_speed_on_own_draws": chosen.mean_speed,
                "failed_on_own_draws": chosen.failed,
            }
        )
    return {"settings": jobs[0].config.to_dict(), "summary": summarise(episodes), "runs": runs}


def line_of(algorithm: str, result: dict[str, Any]) -> list[str]:
    """The line of an algorithm; steps, time and own draws are medians over its seeds."""
    summary, runs = result["summary"], result["runs"]
    steps, seconds, own = (
        statistics.median(run[name] for run in runs) for name in ("steps", "core_seconds", "mean_speed_on_own_draws")
    )
    return [
        algorithm,
        str(len(runs)),
        SPEED.with_interval(summary["mean_speed"]),
        f"{summary['failures']}/{summary['episodes']}",
        TRANSPORT.with_interval(summary["cost_of_transport"]),
        f"{own:.2f}",
        f"{steps:,.0f}",
        f"{steps / seconds:,.0f}",
        f"{seconds / 60.0:.1f}",
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found, evaluation_set = machine(*PACKAGES, "sb3-contrib"), load_set(options.set)
    settings = {algorithm: settings_of(algorithm, options.part) for algorithm in options.algorithms}
    names = {algorithm: f"direct-{algorithm}-{config.total_steps}" for algorithm, config in settings.items()}
    try:
        jobs = plan_of({names[a]: config for a, config in settings.items()}, seeds_of(options.seeds), options.runs)
        outcomes = train_all(jobs, options.runs, options.jobs)
    except (RunError, OSError) as error:
        refuse(COMMAND, str(error))
    tell_failures(outcomes)
    finished = [outcome.job for outcome in outcomes if outcome.state == "finished"]
    results = {}
    for algorithm, name in names.items():
        own = [job for job in finished if job.row == name]
        if own:
            results[algorithm] = result_of(own, evaluation_set)
    table = [HEADER, *(line_of(algorithm, result) for algorithm, result in results.items())]
    print(text_table(table, left=1))
    note = (
        f"{describe(found)}. Interquartile means on the set {evaluation_set.name}, over training seeds; the other "
        "columns are medians over seeds, processor time includes the evaluations while training."
    )
    if options.part != 1.0:
        note += f" Trained for {options.part:g} of the presets' steps."
    numbers = {
        "machine": found,
        "part": options.part,
        "set": evaluation_set.name,
        "set_hash": evaluation_set.hash,
        "algorithms": results,
    }
    options.write(COMMAND, numbers, section("algorithms", [markdown_table(table), "", note]))
    if any(outcome.state == "stopped" for outcome in outcomes):
        print("Stopped; saved. The same command goes on.", file=sys.stderr)
        return INTERRUPTED
    return 1 if len(finished) < len(jobs) else 0


if __name__ == "__main__":
    leave(main)
