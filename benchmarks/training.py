"""Learning and speed of PPO, compared with Stable-Baselines3's own: `python -m benchmarks.training`.

All agents command the whole torque on the paper's plants, and are trained in turns. Seconds are processor time without
the evaluations. Learning curves are evaluated on separate plants, not on a frozen set.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.evaluation.statistics import estimate, learning_curve, paired_difference
from agents.training.config import PPOConfig
from agents.training.presets import PRESETS
from baselines import drawing
from benchmarks.measurement import OutputArgs, machine
from capsule_gym.command_line import Count, parse
from capsule_gym.files import replacing

COMMAND = "python -m benchmarks.training"
EVALUATIONS = 16
# Seed of the plants for evaluations, which no run uses for selection and no frozen set contains.
PLANTS_SEED = 4_000
# Points of the learning curve in the table, as fractions of the total steps.
SHOWN = (0.25, 0.5, 0.75, 1.0)
# The preset of the release before rollouts and updates were compiled, copied since the current preset may change.
TUNED: dict[str, Any] = {
    **{"num_envs": 64, "n_steps": 256, "batch_size": 2048, "n_epochs": 6},
    **{"learning_rate": 1e-3, "final_learning_rate": 1e-4, "gamma": 0.995, "gae_lambda": 0.98, "ent_coef": 0.0},
    **{"hidden": 64, "log_std_init": -0.5, "termination_penalty": 30.0},
}
COLOURS = (drawing.BLUE, drawing.VERMILION, drawing.GREEN, drawing.PURPLE)


def configure(**changes: Any) -> PPOConfig:
    """The preset of the direct task with some fields changed."""
    preset = PRESETS["direct", "ppo"]
    assert isinstance(preset, PPOConfig)
    return dataclasses.replace(preset, **changes)


PRESET, PEER = "preset", "SB3's PPO"
LEARNERS = {PRESET: configure(), PEER: configure(**TUNED, stock=True), "256 x 64": configure(num_envs=256, n_steps=64)}


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Learning curves and environment steps per second of PPO, compared with Stable-Baselines3's own.

    Examples:
      python -m benchmarks.training --markdown docs/train_fast_tables.md --figure docs/figures/training_curves.png
    """

    seeds: Count = 5
    """Number of training seeds of each learning curve."""
    total_steps: Count = 2**20
    """Environment steps of a learning curve."""
    figure: Path | None = None
    """Draw the learning curves into this PNG file."""

    def check(self) -> None:
        """Raises an error if a file cannot be written or a number is out of range."""
        super().check()
        if self.seeds < 2:
            raise ValueError(f"--seeds must be at least 2, for an interval over them, got {self.seeds}")


@dataclass(frozen=True)
class Run:
    """A learning curve.

    Attributes:
        name: name of the settings in `LEARNERS`.
        seed: training seed.
        steps: environment steps before each evaluation of the deterministic policy.
        seconds: processor time before each evaluation, without the evaluations.
        mean_speed: interquartile mean over the episodes of each evaluation, cm/s.
        failed: share of failed episodes in each evaluation.
    """

    name: str
    seed: int
    steps: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    mean_speed: list[float] = field(default_factory=list)
    failed: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Environment steps per second."""
        return self.steps[-1] / self.seconds[-1]

    def speed_at(self, part: float) -> float:
        """The mean speed at the evaluation that is nearest to a fraction of the steps."""
        return self.mean_speed[int(np.abs(np.array(self.steps) - part * self.steps[-1]).argmin())]


def learn(name: str, config: PPOConfig) -> Run:
    """Trains for `total_steps` and evaluates the deterministic policy about `EVALUATIONS` times, between updates."""
    # Imported here, since torch takes seconds to import and --help does not need it.
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    from agents.evaluation.episodes import evaluate, scores
    from agents.evaluation.statistics import interquartile_mean
    from agents.training.algorithms import make_env, make_model
    from agents.training.callbacks import validation_plants
    from agents.training.export import export

    torch.set_num_threads(1)
    run = Run(name, config.seed)
    plants = validation_plants(dataclasses.replace(config, seed=PLANTS_SEED))
    every = max(1, config.total_steps // EVALUATIONS)

    class Evaluation(BaseCallback):
        began = 0.0

        def _on_training_start(self) -> None:
            self.began = time.process_time()

        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:
            if self.num_timesteps - (run.steps[-1] if run.steps else 0) >= every:
                self._on_training_end()

        def _on_training_end(self) -> None:
            now = time.process_time()
            episodes = evaluate(export(run.name, self.model, config, "none"), plants)
            run.steps.append(self.num_timesteps)
            run.seconds.append(round(now - self.began, 3))
            run.mean_speed.append(round(float(interquartile_mean(scores(episodes, "mean_speed"))[0]), 4))
            run.failed.append(float(scores(episodes, "failed").mean()))
            self.began += time.process_time() - now

    with closing(make_env(config, config.seed)) as env:
        make_model(config, env).learn(config.total_steps, callback=Evaluation())
    return run


def learning(seeds: int, total_steps: int) -> dict[str, list[Run]]:
    """Trains `LEARNERS`; returns the learning curves over seeds, by name."""
    runs: dict[str, list[Run]] = {name: [] for name in LEARNERS}
    with tqdm(total=seeds * len(LEARNERS), desc="learning", unit=" trainings") as bar:
        for name, config in LEARNERS.items():  # compiles before a clock runs
            learn(name, dataclasses.replace(config, total_steps=1))
        for seed in range(seeds):
            for name, config in LEARNERS.items():
                runs[name].append(learn(name, dataclasses.replace(config, seed=seed, total_steps=total_steps)))
                bar.update()
    return runs


def learning_table(runs: Mapping[str, Sequence[Run]]) -> list[list[str]]:
    """The learning curves as a table; intervals are over seeds."""
    peers = runs[PEER]
    shown = (f"at {100.0 * part:g} %" for part in SHOWN)
    table = [["", "seeds", "steps/s", "ratio (range)", *shown, "whole curve", "failures"]]
    for name, own in runs.items():
        ratios = [run.rate / peer.rate for run, peer in zip(own, peers, strict=True)]
        speeds = [estimate([[run.speed_at(part)] for run in own]) for part in SHOWN]
        speeds.append(estimate([[statistics.mean(run.mean_speed)] for run in own]))
        table.append(
            [
                name,
                str(len(own)),
                f"{statistics.median(run.rate for run in own):,.0f}",
                "" if own is peers else f"{statistics.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})",
                *(f"{found.value:.1f} [{found.low:.1f}, {found.high:.1f}]" for found in speeds),
                f"{100.0 * statistics.mean(run.failed[-1] for run in own):.1f} %",
            ]
        )
    return table


def difference(runs: Mapping[str, Sequence[Run]]) -> str:
    """A sentence with the difference in mean speed over the whole curve between the preset and its peer."""
    own, other = (np.array([[statistics.mean(run.mean_speed)] for run in runs[name]]) for name in (PRESET, PEER))
    found = paired_difference(own, other)
    return (
        f"Over the whole curve the preset is {found.value:+.1f} cm/s [{found.low:+.1f}, {found.high:+.1f}] compared "
        f"with {PEER} from as many steps."
    )


def draw(runs: Mapping[str, Sequence[Run]], note: str) -> Any:
    """Draws the learning curves over environment steps and over seconds; call it in `drawing.style`."""
    figure = drawing.new_figure(3.1)
    left, right = figure.subplots(1, 2, sharey=True)
    for (name, own), colour in zip(runs.items(), COLOURS, strict=False):
        curve = learning_curve([(run.steps, run.mean_speed) for run in own])
        seconds = np.median([run.seconds for run in own], axis=0)
        for axes, x in ((left, curve.x / 1e6), (right, seconds)):
            axes.fill_between(x, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0.0)
            axes.plot(x, curve.value, color=colour, label=name)
    left.set(xlabel="environment steps (millions)", ylabel="mean speed (cm/s)", xlim=(0.0, None), ylim=(-1.0, None))
    right.set(xlabel="seconds of processor time", xscale="log")
    left.legend(loc="upper left")
    drawing.add_note(figure, note)
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    found = machine("stable-baselines3", "torch")
    runs = learning(args.seeds, args.total_steps)
    table, words = learning_table(runs), difference(runs)
    note = f"Interquartile means with 95 % intervals over seeds; {args.total_steps:,} steps. {found}."
    if args.figure is not None:
        with drawing.style(), replacing(args.figure) as temporary:
            # At this resolution, the file is half as large as at that of the paper's figures.
            draw(runs, note).savefig(temporary, format="png", dpi=130, metadata={"Software": None})
    args.report(COMMAND, table, words, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
