"""What each algorithm's preset learns of the direct task, and what a memory does: `python -m benchmarks.algorithms`.

Runs are trained through `agents.study`, so that a comparison that is interrupted goes on when it is called again. A
run's best policy is chosen on its own draws; the frozen set is looked at once, at the end. Minutes are those of the
processor, of the quickest run: what else the machine does counts little.
"""

from __future__ import annotations

import dataclasses
import json
import statistics
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from tyro.conf import arg

from agents.evaluation.episodes import Episode, evaluate, summarise
from agents.evaluation.sets import EvaluationSet, load_set
from agents.evaluation.tables import MEASURES
from agents.study.jobs import Job, best, evaluations, plan_of, seeds_of
from agents.study.study import check_jobs, leave, tell_failures, train_all
from agents.study.tune import DATA
from agents.training.errors import RunError
from agents.training.presets import PRESETS, ROWS, Algorithm, Config, PPOConfig
from agents.training.stopping import INTERRUPTED
from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, section
from benchmarks.trainers import PACKAGES
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.parameters import check_number

COMMAND = "python -m benchmarks.algorithms"
RUNS = Path("runs/algorithms")
# Of a configuration, in environment steps.
LENGTHS = ("total_steps", "evaluate_every")
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
SEARCHES = [
    "search",
    "trials",
    "pruned",
    "best score (cm/s)",
    "median of whole trials",
    "steps of the best",
    "minutes of one core",
]


def presets() -> dict[str, Config]:
    """The presets of the direct task."""
    return {algorithm: PRESETS["direct", algorithm] for algorithm in get_args(Algorithm)}


def memories() -> dict[str, Config]:
    """PPO that remembers nothing of the plant, that identifies M and mu, and that has the state of an LSTM.

    All are trained for the steps of the last, on plants that differ enough for it to matter.
    """
    recurrent = dataclasses.replace(PRESETS["direct", "recurrent-ppo"], randomization="wide")
    lengths = {name: getattr(recurrent, name) for name in LENGTHS}
    row = ROWS["direct-ppo-wide"]
    assert isinstance(row, PPOConfig)
    plain = dataclasses.replace(row, **lengths)
    return {
        "wide-ppo": plain,
        "wide-ppo-identifies": dataclasses.replace(plain, identifies=True),
        "wide-recurrent-ppo": recurrent,
    }


# By the sections of the page; a contender is compared with those of its own.
COMPARISONS: dict[str, Callable[[], dict[str, Config]]] = {"algorithms": presets, "memory": memories}


def contenders() -> dict[str, Config]:
    """What can be trained, by name."""
    return {name: config for comparison in COMPARISONS.values() for name, config in comparison().items()}


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """Trains the preset of every algorithm on the direct task, and PPO with and without a memory, and compares them.

    Ctrl-C saves and stops; the same command goes on.

    Examples:
      python -m benchmarks.algorithms --markdown docs/algorithms_tables.md
      python -m benchmarks.algorithms ppo sac --seeds 0 --part 0.5
    """

    names: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="NAME", help=f"Any of {', '.join(contenders())}; all where none is named."),
    ] = ()
    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-2",)
    """Training seeds, and ranges of them such as 0-9."""
    part: float = 1.0
    """Part of the settings' environment steps that is trained."""
    jobs: int | None = None
    """Runs that are trained at a time; as many as there are cores."""
    set: str | None = None
    """Evaluation set, by its name or its path; that of the ranges that a run is trained in where none is given."""
    runs: Path = RUNS
    """Folder of the runs, each in NAME-STEPS/seed-N."""

    def check(self) -> None:
        """Refuses what cannot be trained, evaluated or written."""
        super().check()
        known = contenders()
        for name in self.names:
            if name not in known:
                raise ValueError(f"NAME must be one of {', '.join(known)}, got {name!r}")
        seeds_of(self.seeds)
        check_jobs(self.jobs)
        check_number("--part", self.part, "a finite number > 0", 0.0, open_low=True)
        if self.set is not None:
            load_set(self.set)

    def settings(self) -> dict[str, Config]:
        """What is trained, by name, for its part of the steps."""
        return {
            name: dataclasses.replace(
                config, **{length: max(1, round(self.part * getattr(config, length))) for length in LENGTHS}
            )
            for name, config in contenders().items()
            if name in self.names or not self.names
        }


def result_of(jobs: Sequence[Job], evaluation_set: EvaluationSet) -> dict[str, Any]:
    """What the finished runs of a contender have learnt and cost.

    Args:
        jobs: its runs.
        evaluation_set: what their best policies run on, once.

    Returns:
        The summary of their episodes, and per run its steps, its processor time and its best speed on its own draws.
    """
    import torch

    from agents.training.recurrent import load_best

    # On a busy machine threads wait for each other, and what they compute is small.
    torch.set_num_threads(1)
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
    return {
        "settings": {"algo": jobs[0].config.algo, **jobs[0].config.to_dict()},
        "set": evaluation_set.name,
        "set_hash": evaluation_set.hash,
        "summary": summarise(episodes),
        "runs": runs,
    }


def line_of(name: str, result: dict[str, Any]) -> list[str]:
    """The line of a contender; own draws are a median over its seeds, time is that of the quickest run.

    All runs are equally long, and what else a machine does at the time only adds to the time they take.
    """
    summary, runs = result["summary"], result["runs"]
    own = statistics.median(run["mean_speed_on_own_draws"] for run in runs)
    steps, seconds = runs[0]["steps"], min(run["core_seconds"] for run in runs)
    return [
        name,
        str(len(runs)),
        SPEED.with_interval(summary["mean_speed"]),
        f"{summary['failures']}/{summary['episodes']}",
        TRANSPORT.with_interval(summary["cost_of_transport"]),
        f"{own:.2f}",
        f"{steps:,}",
        f"{steps / seconds:,.0f}",
        f"{seconds / 60.0:.1f}",
    ]


def searches(folder: Path = DATA) -> list[list[str]]:
    """The table of the committed searches behind the presets; scores are those of the trials' own draws.

    Args:
        folder: of their files.
    """
    table = [SEARCHES]
    for path in sorted(folder.glob("*.json")):
        content = json.loads(path.read_text(encoding="utf-8"))
        at = {name: column for column, name in enumerate(content["evaluations"])}
        ends = [trial["evaluations"][-1] for trial in content["trials"]]
        scores = [trial["score"] for trial in content["trials"] if trial["score"] is not None]
        first = next(end for end, trial in zip(ends, content["trials"], strict=True) if trial["score"] == max(scores))
        table.append(
            [
                content["row"],
                str(len(ends)),
                str(len(ends) - len(scores)),
                f"{max(scores):.2f}",
                f"{statistics.median(scores):.2f}",
                f"{first[at['steps']]:,}",
                f"{sum(end[at['core_seconds']] for end in ends) / 60.0:.0f}",
            ]
        )
    return table


def tables_of(results: dict[str, dict[str, Any]]) -> dict[str, list[list[str]]]:
    """The table of every comparison that has results, by its name."""
    tables = {}
    for comparison, members in COMPARISONS.items():
        lines = [line_of(name, results[name]) for name in members() if name in results]
        if lines:
            tables[comparison] = [HEADER, *lines]
    return tables


def note_on(found: dict[str, Any], sets: Iterable[str], part: float) -> str:
    """What stands under a table."""
    note = (
        f"{describe(found)}. Interquartile means on the set {', '.join(sets)}, over training seeds; on own draws "
        "the median. Processor time is that of the quickest run, the evaluations while training included."
    )
    return note if part == 1.0 else f"{note} Trained for {part:g} of the settings' steps."


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found = machine(*PACKAGES, "sb3-contrib")
    settings = options.settings()
    rows = {name: f"{name}-{config.total_steps}" for name, config in settings.items()}
    try:
        jobs = plan_of({rows[name]: config for name, config in settings.items()}, seeds_of(options.seeds), options.runs)
        outcomes = train_all(jobs, options.runs, options.jobs)
    except (RunError, OSError) as error:
        refuse(COMMAND, str(error))
    tell_failures(outcomes)
    finished = [outcome.job for outcome in outcomes if outcome.state == "finished"]
    results = {}
    for name, config in settings.items():
        own = [job for job in finished if job.row == rows[name]]
        if own:
            results[name] = result_of(own, load_set(options.set or config.randomization))
    lines = []
    for comparison, table in tables_of(results).items():
        print(text_table(table, left=1))
        sets = dict.fromkeys(results[line[0]]["set"] for line in table[1:])
        lines += section(comparison, [markdown_table(table), "", note_on(found, sets, options.part)])
    lines += section("searches", [markdown_table(searches())])
    options.write(COMMAND, {"machine": found, "part": options.part, "contenders": results}, lines)
    if any(outcome.state == "stopped" for outcome in outcomes):
        print("Stopped; saved. The same command goes on.", file=sys.stderr)
        return INTERRUPTED
    return 1 if len(finished) < len(jobs) else 0


if __name__ == "__main__":
    leave(main)
