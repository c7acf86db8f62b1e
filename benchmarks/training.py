"""What PPO learns, and how soon, beside Stable-Baselines3's own: `python -m benchmarks.training`.

The contenders command the whole torque on the paper's plants. They take turns, a training each, seed by seed; seconds
are of processor time, without the evaluations. Evaluated is on plants that are drawn for this alone, no frozen set.
"""

from __future__ import annotations

import dataclasses
import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tqdm import tqdm
from tyro.conf import arg

from agents.evaluation.statistics import Estimate, estimate, learning_curve, paired_difference
from agents.study.jobs import seeds_of
from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one, section
from benchmarks.trainers import FORMER, PACKAGES, Run, ppo
from capsule_gym.command_line import Count, check_output, parse
from capsule_gym.files import canonical_hash, to_json, write_atomically

if TYPE_CHECKING:
    from benchmarks.trainers import Trainer

COMMAND = "python -m benchmarks.training"
RUNS = Path("runs/benchmark-training")
PRESET, PEER = ppo("preset"), ppo("SB3's PPO", own=False, **FORMER)
# Settings that the preset is compared with by fewer seeds.
OTHERS = (ppo("ReLU", activation="relu"), ppo("256 x 64", num_envs=256, n_steps=64))
EVALUATIONS = 16
# Points of the curve that the table shows, as parts of the whole.
SHOWN = (0.25, 0.5, 0.75, 1.0)
# What "learnt per minute" asks for, cm/s.
GOAL = 10.0


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """Trains the preset, Stable-Baselines3's own PPO as it was the preset before, and other settings.

    Ctrl-C stops; the same command goes on with the trainings that are missing.

    Examples:
      python -m benchmarks.training --markdown docs/train_fast_learning.md --figure docs/figures/training_curves.png
      python -m benchmarks.training --seeds 0-1 --other-seeds 0 --total-steps 262144
    """

    seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-4",)
    """Training seeds of the preset and of Stable-Baselines3's PPO, and ranges of them such as 0-9."""
    other_seeds: Annotated[tuple[str, ...], arg(metavar="N")] = ("0-2",)
    """Training seeds of the other settings; none where none is given."""
    total_steps: Count = 2**20
    """Environment steps of a training."""
    runs: Path = RUNS
    """Folder of the trainings that are finished."""
    figure: Path | None = None
    """Draw the learning curves into this file (PNG)."""

    def check(self) -> None:
        """Refuses what cannot be trained or written."""
        super().check()
        check_output("--figure", self.figure, overwrite=True)
        if len(seeds_of(self.seeds)) < 2:
            raise ValueError(f"--seeds must be at least two, for an interval over them, got {' '.join(self.seeds)}")
        seeds_of(self.other_seeds, "--other-seeds")
        check_at_least_one("--total-steps", self.total_steps)

    def plan(self) -> list[Trainer]:
        """The trainings, seed by seed: one that is cut short has something of each."""
        seeds, others = seeds_of(self.seeds), seeds_of(self.other_seeds)
        return [
            dataclasses.replace(
                trainer, config=dataclasses.replace(trainer.config, seed=seed, total_steps=self.total_steps)
            )
            for seed in sorted({*seeds, *others})
            for trainer, own in ((PRESET, seeds), (PEER, seeds), *((each, others) for each in OTHERS))
            if seed in own
        ]


def path_of(trainer: Trainer, folder: Path) -> Path:
    """Where a finished training lies: named by its settings, the same ones are the same training."""
    settings = {"own": trainer.own, "vec_env": trainer.vec_env, **trainer.config.to_dict()}
    return folder / f"{canonical_hash(settings)[:12]}.json"


def train_all(plan: Sequence[Trainer], folder: Path) -> list[Run]:
    """The trainings of a plan that are finished: earlier ones, and those until Ctrl-C."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [trainer for trainer in plan if not path_of(trainer, folder).is_file()]
    if missing:
        # torch takes seconds to import, which --help need not wait for.
        from benchmarks.training_runs import train, warm_up

        with tqdm(missing, unit=" trainings", dynamic_ncols=True) as bar:
            try:
                for trainer in {trainer.name: trainer for trainer in missing}.values():
                    warm_up(trainer)
                for trainer in bar:
                    bar.set_description(f"{trainer.name}, seed {trainer.config.seed}")
                    run = train(trainer, max(1, trainer.config.total_steps // EVALUATIONS))
                    write_atomically(path_of(trainer, folder), to_json(dataclasses.asdict(run)))
            except KeyboardInterrupt:
                print("\nStopped; the same command goes on. What is finished:", file=sys.stderr)
    paths = [path_of(trainer, folder) for trainer in plan]
    return [Run(**json.loads(path.read_text(encoding="utf-8"))) for path in paths if path.is_file()]


def by_name(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """The runs of each contender."""
    return {name: [run for run in runs if run.name == name] for name in dict.fromkeys(run.name for run in runs)}


def ratios(runs: Sequence[Run], peers: Sequence[Run]) -> list[float]:
    """How many times the peer's steps per second, by each seed that both have."""
    rates = {run.seed: run.rate for run in peers}
    return [run.rate / rates[run.seed] for run in runs if run.seed in rates]


def speed_difference(runs: Sequence[Run], peers: Sequence[Run]) -> Estimate:
    """Of the mean speed over the whole curve, what it is more than the peer's."""
    own, other = (np.array([[statistics.mean(run.mean_speed)] for run in each]) for each in (runs, peers))
    return paired_difference(own, other)


def compared(runs: Sequence[Run], peers: Sequence[Run]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At which steps the one's mean is below the other's interval, in it, and above it."""
    own, other = (learning_curve([(run.steps, run.mean_speed) for run in each]) for each in (runs, peers))
    value = own.value[np.searchsorted(own.x, other.x, side="right") - 1]
    below, above = value < other.low, value > other.high
    return other.x[below], other.x[~below & ~above], other.x[above]


def rows(runs: Mapping[str, Sequence[Run]]) -> list[list[str]]:
    """The comparison as a table; intervals are over seeds."""
    peers = runs[PEER.name]
    head = [
        "",
        "seeds",
        "steps/s",
        "ratio (range)",
        *(f"at {100.0 * part:g} %" for part in SHOWN),
        "whole curve",
        "failures",
    ]
    table = [[*head, f"s to {GOAL:g} cm/s"]]
    for name, own in runs.items():
        found = ratios(own, peers)
        table.append(
            [
                name,
                str(len(own)),
                f"{statistics.median(run.rate for run in own):,.0f}",
                "" if own is peers else f"{statistics.median(found):.1f} ({min(found):.1f} to {max(found):.1f})",
                *(_interval(estimate([[run.at(part)] for run in own])) for part in SHOWN),
                _interval(estimate([[statistics.mean(run.mean_speed)] for run in own])),
                f"{100.0 * statistics.mean(run.failed[-1] for run in own):.1f} %",
                f"{statistics.median(run.seconds_to(GOAL) for run in own):.1f}",
            ]
        )
    return table


def _interval(found: Estimate) -> str:
    """A speed with its interval, where there is one."""
    interval = f" [{found.low:.1f}, {found.high:.1f}]" if found.resampled != "nothing" else ""
    return f"{found.value:.1f}{interval}"


def verdict(runs: Mapping[str, Sequence[Run]]) -> str:
    """What the comparison of the preset with its peer comes to, in a sentence."""
    own, peers = runs[PRESET.name], runs[PEER.name]
    below, inside, above = compared(own, peers)
    found, difference = ratios(own, peers), speed_difference(own, peers)
    last = f" below it, the last at {below[-1] / 1e6:.2f} M steps" if below.size else " below it"
    return (
        f"The preset makes {statistics.median(found):.1f} times the steps per second of {PEER.name}. Of its "
        f"{below.size + inside.size + above.size} evaluations {inside.size} lie within the other's interval, "
        f"{above.size} above and {below.size}{last}. Over the whole curve it is {difference.value:+.1f} cm/s "
        f"[{difference.low:+.1f}, {difference.high:+.1f}]."
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found, plan = machine(*PACKAGES), options.plan()
    runs = by_name(train_all(plan, options.runs))
    if not {PRESET.name, PEER.name} <= runs.keys():
        return 1
    table, words = rows(runs), verdict(runs)
    print(f"\n{text_table(table)}\n\n{words}")
    note = (
        f"Speeds in cm/s, interquartile means with 95 % intervals over training seeds; {options.total_steps:,} steps. "
        f"{describe(found)}."
    )
    settings = {trainer.name: trainer.config.to_dict() for trainer in (PRESET, PEER, *OTHERS)}
    numbers = {"machine": found, "settings": settings, "runs": [vars(run) for each in runs.values() for run in each]}
    options.write(COMMAND, numbers, section("learning", [markdown_table(table), "", words, "", note]))
    if options.figure is not None:
        from benchmarks.training_figure import save

        save(options.figure, runs, note)
    return 0 if sum(map(len, runs.values())) == len(plan) else 1


if __name__ == "__main__":
    sys.exit(main())
