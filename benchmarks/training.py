"""What training costs and what it learns, with one setting changed at a time.

    python -m benchmarks.training              # trains several settings and compares what they have learned
    python -m benchmarks.training --sweep      # steps per second, updates included
    python -m benchmarks.training --profile    # where the time of a training goes

Absolute numbers do not carry from machine to machine; the ratios do. In --sweep and --profile the contenders take
turns, so that whatever else the machine does meets them all, and the medians of the turns count. Ctrl-C ends each of
the three early and keeps what there is; a comparison goes on where it stopped when it is called again.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.evaluation.candidates import find_candidate
from agents.evaluation.episodes import Episode, difference, evaluate, summarise, versions
from agents.evaluation.sets import EvaluationSet, load_set
from agents.evaluation.tables import MEASURES
from agents.training.loop import begin, train
from agents.training.presets import MODEL, PPOConfig
from agents.training.runs import load_policy
from baselines.tables import markdown_table, text_table
from benchmarks.timing import available_cores
from benchmarks.training_cost import BROAD, UNTUNED, axes, sweep, sweep_rows
from benchmarks.training_profile import profile, profile_rows, profiled
from capsule_gym.files import to_json, write_atomically

RUNS = Path("runs/benchmark-training")
COST = "cost.json"
SPEED = MEASURES["mean_speed"]

SETTINGS: dict[str, dict[str, Any]] = {"tuned": {}, "untuned": UNTUNED, "broad": BROAD}
# Points of the learning curve that the table shows, as parts of the whole.
CURVE = (0.25, 0.5, 0.75, 1.0)


# --- what is learned -------------------------------------------------------------------------------------------------


def train_run(run: Path, config: PPOConfig) -> bool:
    """Trains a run, or goes on with it; adds up its processor time. Returns whether it came to its end."""
    if (run / MODEL).is_file() and (run / COST).is_file():
        if json.loads((run / COST).read_text(encoding="utf-8"))["done"]:
            return True
    spent = 0.0
    if (run / COST).is_file():
        spent = json.loads((run / COST).read_text(encoding="utf-8"))["processor_seconds"]
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


def comparison_rows(results: dict[str, Any], steps: int) -> list[list[str]]:
    """The comparison as a table; the curve's points are means over the seeds."""
    head = ["setting", "seeds", "mean speed (cm/s) [95 %]", "difference", "failures"]
    rows = [[*head, *(f"at {part * steps / 1e6:g} M" for part in CURVE), "steps/s", "minutes"]]
    for n, (name, result) in enumerate(results.items()):
        summary, runs = result["summary"], result["runs"]
        cells = []
        for part in CURVE:
            speeds = [min(run["curve"], key=lambda point: abs(point[0] - part * steps))[1] for run in runs]
            cells.append(f"{statistics.mean(speeds):.2f}" if speeds else "")
        cost = ["", ""]
        if runs:
            cost = [
                f"{statistics.median(run['steps_per_second'] for run in runs):,.0f}",
                f"{statistics.median(run['processor_seconds'] for run in runs) / 60:.1f}",
            ]
        rows.append(
            [
                name,
                str(len(summary["training_seeds"])),
                SPEED.with_interval(summary["mean_speed"]),
                SPEED.with_interval(result["difference"], sign=True) if n else "",
                f"{summary['failures']}/{summary['episodes']}",
                *cells,
                *cost,
            ]
        )
    return rows


# --- what it costs ---------------------------------------------------------------------------------------------------


# --- where it goes ---------------------------------------------------------------------------------------------------


# --- the command line ------------------------------------------------------------------------------------------------


def machine() -> str:
    """The machine, in words."""
    return f"{available_cores()} of {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


def number(text: str) -> int:
    """A positive integer, also in the form 6e6."""
    value = float(text)
    if value != int(value) or value < 1:
        raise argparse.ArgumentTypeError(f"must be an integer >= 1, got {text!r}")
    return int(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.training",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    kinds = parser.add_mutually_exclusive_group()
    known = axes()
    kinds.add_argument(
        "--sweep",
        nargs="*",
        metavar="AXIS",
        choices=list(known),
        help=f"measure steps per second along these axes (default: all): {', '.join(known)}",
    )
    kinds.add_argument("--profile", action="store_true", help="measure what the time of a training goes to")
    parser.add_argument(
        "--settings",
        nargs="+",
        default=["tuned", "untuned"],
        metavar="NAME",
        help=f"what is compared: {', '.join(SETTINGS)}, or a committed checkpoint, which is only evaluated; "
        "differences are to the first (default: tuned untuned)",
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="default: 0 1 2")
    parser.add_argument("--steps", type=number, default=6_000_000, metavar="N", help="of each run (default: 6e6)")
    parser.add_argument("--set", default="paper", metavar="SET", help="evaluation set (default: paper)")
    parser.add_argument("--runs", type=Path, default=RUNS, metavar="DIR", help=f"folder of the runs (default: {RUNS})")
    parser.add_argument("--turns", type=number, default=5, metavar="N", help="of every contender (default: 5)")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="of a turn, about (default: 2)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to this new file")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables to this file")
    options = parser.parse_args(arguments)
    if options.json is not None and options.json.exists():
        parser.error(f"--json must name a new file, got {str(options.json)!r}")
    if options.sweep is not None:
        rates: dict[str, dict[str, list[float]]] = {}
        tables: dict[str, list[list[str]]] = {}
        content: dict[str, Any] = {"env_steps_per_second": rates, "turns": options.turns, "seconds": options.seconds}
        note = f"{options.turns} turns of about {options.seconds:g} s"
        for axis in options.sweep or known:
            measured = sweep(known[axis], options.turns, options.seconds, axis)
            if known[axis][0].name not in measured:
                break
            rates[axis], tables[axis] = measured, sweep_rows(known[axis], measured)
            print(f"\n{axis}\n\n{text_table(tables[axis])}", flush=True)
            # After every axis, so that nothing is lost.
            write(options, content, tables, note)
        return 0
    if options.profile:
        parts = profile(profiled(), options.turns, options.seconds)
        content = {"microseconds_per_env_step": parts, "turns": options.turns, "seconds": options.seconds}
        rows = profile_rows(parts)
        note = f"{options.turns} turns of about {options.seconds:g} s"
    else:
        try:
            evaluation_set = load_set(options.set)
            for name in options.settings:
                if name not in SETTINGS:
                    find_candidate(name)
        except ValueError as error:
            parser.error(str(error))
        results = compare(options.settings, options.seeds, options.steps, options.runs, evaluation_set)
        content = {
            "steps": options.steps,
            "set": evaluation_set.name,
            "set_hash": evaluation_set.hash,
            "settings": results,
        }
        rows = comparison_rows(results, options.steps)
        note = f"steps/s and minutes of processor time, evaluations included; the set is {evaluation_set.name}"
    print(f"\n{text_table(rows)}")
    write(options, content, {"profile" if options.profile else "learning": rows}, note)
    return 0


def write(options: argparse.Namespace, content: dict[str, Any], tables: dict[str, list[list[str]]], note: str) -> None:
    """Writes the numbers and the tables where the command line wants them."""
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(options.json, to_json({"machine": machine(), "versions": versions(), **content}))
    if options.markdown is not None:
        lines = ["<!-- Written by python -m benchmarks.training: do not edit. -->", ""]
        for name, rows in tables.items():
            lines += [f"<!-- --8<-- [start:{name}] -->", markdown_table(rows)]
            lines += ["", f"{machine()}; {note}.", f"<!-- --8<-- [end:{name}] -->", ""]
        write_atomically(options.markdown, "\n".join(lines))


if __name__ == "__main__":
    sys.exit(main())
