"""Environment steps per second of a training, updates included: `python -m benchmarks.training_speed`.

One setting is changed at a time. Absolute numbers do not carry from machine to machine; the ratios do: the contenders
of an axis take turns, and the medians of the turns count. Seconds are of processor time, which is that of the clock on
an idle core.
"""

from __future__ import annotations

import statistics
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from baselines.tables import markdown_table, text_table
from benchmarks.machine import machine
from benchmarks.output import section
from benchmarks.trainers import FORMER, PACKAGES, UNTUNED, Trainer, TurnOptions, ppo, sac
from capsule_gym.command_line import parse

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

COMMAND = "python -m benchmarks.training_speed"
# Steps between two updates, whatever the number of environments.
ROLLOUT = 16_384
# Shorter rollouts cost the same per step, and let a turn end sooner.
QUICK = {**UNTUNED, "n_steps": 512}

# What is changed, and what it is changed to; the first of each axis is what the ratios are to.
AXES: dict[str, tuple[Trainer, ...]] = {
    "environments": (
        ppo("64 (preset)"),
        *(ppo(str(count), num_envs=count, n_steps=ROLLOUT // count) for count in (16, 256, 1024)),
    ),
    "minibatch": (
        ppo("2048 (preset)"),
        *(ppo(str(size), batch_size=size) for size in (64, 256, 1024, 4096, 8192)),
    ),
    "peers": (
        ppo("preset"),
        ppo("SB3's PPO, tuned", own=False, **FORMER),
        ppo("SB3's PPO, untuned", own=False, **QUICK),
        ppo("SB3's PPO, untuned, DummyVecEnv", own=False, vec_env="DummyVecEnv", **QUICK),
    ),
    "sac": (
        sac("SB3's SAC", own=False, fused=False),
        sac("SB3's SAC, fused Adam", own=False),
        sac("LeanSAC", fused=False),
        sac("LeanSAC, fused Adam (preset)"),
        sac("preset, batch 2048, 2 updates", batch_size=2048, gradient_steps=2),
        sac("preset, 64 environments, 16 updates", num_envs=64, gradient_steps=16),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Options(TurnOptions):
    """Environment steps per second of a training, updates included, with one setting changed at a time.

    Little else should run meanwhile. Ctrl-C ends it early and keeps what there is.

    Examples:
      python -m benchmarks.training_speed --markdown docs/train_fast_speed.md
      python -m benchmarks.training_speed --axes sac --turns 3
    """

    axes: Annotated[tuple[str, ...], arg(help=f"what is changed: {', '.join(AXES)}")] = tuple(AXES)

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        for axis in self.axes:
            if axis not in AXES:
                raise ValueError(f"--axes must be of {', '.join(AXES)}, got {axis!r}")


def sweep(trainers: Sequence[Trainer], turns: int, seconds: float, title: str) -> dict[str, list[float]]:
    """Environment steps per second of each, one number per turn; arguments as for `take_turns`."""
    # torch takes seconds to import, which --help need not wait for.
    from benchmarks.training_turns import learn, take_turns, unit

    rates: dict[str, list[float]] = defaultdict(list)

    def turn(trainer: Trainer, model: BaseAlgorithm, count: int) -> str:
        rates[trainer.name].append(count * unit(model) / learn(model, count))
        return f"{trainer.name}: {rates[trainer.name][-1]:,.0f} steps/s"

    take_turns(trainers, turns, seconds, title, turn)
    return dict(rates)


def rows(trainers: Sequence[Trainer], rates: Mapping[str, Sequence[float]]) -> list[list[str]]:
    """One axis as a table; ratios are medians over the turns, each to the first contender's turn."""
    table = [["", "env steps/s", "gradient updates/s", "ratio", "range of the ratio"]]
    first = rates[trainers[0].name]
    for trainer in trainers:
        if trainer.name not in rates:
            continue
        rate = statistics.median(rates[trainer.name])
        ratios = [own / other for own, other in zip(rates[trainer.name], first, strict=False)]
        table.append(
            [
                trainer.name,
                f"{rate:,.0f}",
                f"{rate * trainer.updates:,.0f}",
                f"{statistics.median(ratios):.2f}",
                f"{min(ratios):.2f} to {max(ratios):.2f}" if trainer is not trainers[0] else "",
            ]
        )
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found = machine(*PACKAGES)
    rates: dict[str, dict[str, list[float]]] = {}
    numbers: dict[str, Any] = {
        "machine": found,
        "turns": options.turns,
        "seconds": options.seconds,
        "env_steps_per_second": rates,
    }
    lines: list[str] = []
    for axis in options.axes:
        trainers = AXES[axis]
        measured = sweep(trainers, options.turns, options.seconds, axis)
        if trainers[0].name not in measured:
            break
        rates[axis], table = measured, rows(trainers, measured)
        print(f"\n{axis}\n\n{text_table(table)}", flush=True)
        lines += section(axis, [markdown_table(table), "", options.note(found)])
        # After every axis, so that nothing is lost.
        options.write(COMMAND, numbers, lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
