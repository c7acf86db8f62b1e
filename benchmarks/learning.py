"""What settings of a training learn, and at what cost: `python -m benchmarks.learning`.

Each setting is trained with several seeds and its best model evaluated on a frozen set. A comparison that is
interrupted goes on where it stopped when it is called again.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from agents.evaluation.candidates import find_candidate
from agents.evaluation.episodes import Episode, difference, evaluate, summarise
from agents.evaluation.sets import EvaluationSet, load_set
from agents.evaluation.tables import MEASURES
from agents.training.presets import PPOConfig
from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one, section
from benchmarks.trainers import BROAD, PACKAGES, UNTUNED
from capsule_gym import load_policy
from capsule_gym.command_line import Count, described, parse
from capsule_gym.files import to_json, write_atomically

COMMAND = "python -m benchmarks.learning"
RUNS = Path("runs/benchmark-learning")
COST = "cost.json"
SPEED = MEASURES["mean_speed"]

SETTINGS: dict[str, dict[str, Any]] = {"tuned": {}, "untuned": UNTUNED, "broad": BROAD}
# Points of the learning curve that the table shows, as parts of the whole.
CURVE = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """Trains several settings and compares what they have learned on a frozen set.

    Ctrl-C saves and stops; the same command goes on.

    Examples:
      python -m benchmarks.learning --settings residual-ppo untuned --seeds 0
      python -m benchmarks.learning --settings residual-ppo broad --markdown docs/train_fast_broad.md
    """

    settings: Annotated[
        tuple[str, ...],
        described(
            f"what is compared: {', '.join(SETTINGS)}, or a committed checkpoint, which is only evaluated; differences "
            "are to the first"
        ),
    ] = ("tuned", "untuned")
    seeds: tuple[int, ...] = (0, 1, 2)
    """Training seeds of each setting."""
    steps: Count = PPOConfig.total_steps
    """Environment steps of each run."""
    set: str = "paper"
    """Evaluation set, by its name or its path."""
    runs: Path = RUNS
    """Folder of the runs."""

    def check(self) -> None:
        """Refuses what cannot be trained, evaluated or written."""
        super().check()
        check_at_least_one("--steps", self.steps)
        load_set(self.set)
        for name in self.settings:
            if name not in SETTINGS:
                find_candidate(name)


def train_run(run: Path, config: PPOConfig) -> bool:
    """Trains a run, or goes on with it; adds up its processor time. Returns whether it came to its end."""
    # torch takes seconds to import, which --help need not wait for.
    from agents.training.loop import begin, train

    spent = 0.0
    if (run / COST).is_file():
        cost = json.loads((run / COST).read_text(encoding="utf-8"))
        if cost["done"]:
            return True
        spent = cost["processor_seconds"]
    if not run.exists():
        begin(run, config)
    start = time.process_time()
    done = train(run, config)
    write_atomically(run / COST, to_json({"processor_seconds": spent + time.process_time() - start, "done": done}))
    return done


def curve(run: Path) -> list[tuple[int, float]]:
    """Steps and mean speed on the run's own draws at each evaluation while training."""
    with (run / "evaluations.csv").open(encoding="utf-8") as file:
        return [(int(row["steps"]), float(row["mean_speed_cm_s"])) for row in csv.DictReader(file)]


def record(run: Path, seed: int, evaluation_set: EvaluationSet) -> tuple[dict[str, Any], list[Episode]]:
    """What a finished run has cost and learned, and its episodes."""
    points = curve(run)
    seconds = json.loads((run / COST).read_text(encoding="utf-8"))["processor_seconds"]
    episodes = [{**episode, "training_seed": seed} for episode in evaluate(load_policy(run), evaluation_set)]
    content = {
        "seed": seed,
        "steps": points[-1][0],
        "processor_seconds": seconds,
        "steps_per_second": points[-1][0] / seconds,
        "curve": points,
    }
    return content, episodes


def compare(
    names: Sequence[str], seeds: Sequence[int], steps: int, runs: Path, evaluation_set: EvaluationSet
) -> dict[str, Any]:
    """Trains settings with several seeds each and evaluates them on a set.

    Args:
        names: of `SETTINGS`, or of committed checkpoints, which are evaluated only. Differences are to the first.
        seeds: training seeds of each setting.
        steps: environment steps of each run.
        runs: folder of the runs; those that it holds already are gone on with.
        evaluation_set: what counts at the end.

    Returns:
        Per name the summary, the paired difference of the mean speed to the first, and the runs with their cost.
    """
    episodes: dict[str, list[Episode]] = {}
    records: dict[str, list[dict[str, Any]]] = {}
    try:
        for name in names:
            if name not in SETTINGS:
                records[name], episodes[name] = [], find_candidate(name).evaluate(evaluation_set)
        # Seed by seed, so that a comparison that is cut short has something of each setting.
        for seed in seeds:
            for name in (name for name in names if name in SETTINGS):
                config = dataclasses.replace(PPOConfig(), seed=seed, total_steps=steps, **SETTINGS[name])
                run = runs / f"{name}-{steps}-seed{seed}"
                print(f"{name}, seed {seed}, in {run}", file=sys.stderr)
                if not train_run(run, config):
                    raise KeyboardInterrupt
                content, played = record(run, seed, evaluation_set)
                records.setdefault(name, []).append(content)
                episodes.setdefault(name, []).extend(played)
    except KeyboardInterrupt:
        print("\nStopped; the same command goes on from here. What is finished:", file=sys.stderr)
    found = [name for name in names if name in episodes]
    return {
        name: {
            "changes": SETTINGS.get(name),
            "summary": summarise(episodes[name]),
            "difference": difference(episodes[name], episodes[found[0]], "mean_speed").to_dict(),
            "runs": records[name],
        }
        for name in found
    }


def rows(results: Mapping[str, Any], steps: int) -> list[list[str]]:
    """The comparison as a table; the curve's points are means over the seeds."""
    head = ["setting", "seeds", "mean speed (cm/s) [95 %]", "difference", "failures"]
    table = [[*head, *(f"at {part * steps / 1e6:g} M" for part in CURVE), "steps/s", "minutes"]]
    for n, (name, result) in enumerate(results.items()):
        summary = result["summary"]
        table.append(
            [
                name,
                str(len(summary["training_seeds"])),
                SPEED.with_interval(summary["mean_speed"]),
                SPEED.with_interval(result["difference"], sign=True) if n else "",
                f"{summary['failures']}/{summary['episodes']}",
                *_run_cells(result["runs"], steps),
            ]
        )
    return table


def _run_cells(runs: Sequence[Mapping[str, Any]], steps: int) -> list[str]:
    """The curve and the cost of a setting's runs; empty cells where it was only evaluated."""
    if not runs:
        return [""] * (len(CURVE) + 2)
    nearest = [[min(run["curve"], key=lambda point: abs(point[0] - part * steps)) for run in runs] for part in CURVE]
    return [
        *(f"{statistics.mean(speed for _, speed in points):.2f}" for points in nearest),
        f"{statistics.median(run['steps_per_second'] for run in runs):,.0f}",
        f"{statistics.median(run['processor_seconds'] for run in runs) / 60:.1f}",
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found, evaluation_set = machine(*PACKAGES), load_set(options.set)
    results = compare(options.settings, options.seeds, options.steps, options.runs, evaluation_set)
    table = rows(results, options.steps)
    print(f"\n{text_table(table)}")
    note = (
        f"{describe(found)}; steps/s and minutes of processor time, evaluations included; the set is "
        f"{evaluation_set.name}."
    )
    numbers = {
        "machine": found,
        "steps": options.steps,
        "set": evaluation_set.name,
        "set_hash": evaluation_set.hash,
        "settings": results,
    }
    options.write(COMMAND, numbers, section("learning", [markdown_table(table), "", note]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
