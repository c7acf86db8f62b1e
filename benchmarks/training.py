"""Processor time until an agent moves the capsule at 15 cm/s: `python -m benchmarks.training`.

Contenders are the preset of `train.py`, Stable-Baselines3 and SBX (Stable-Baselines3 in JAX) on `make_vec_env` with
their default hyperparameters and `VecNormalize`, as their documentation advises, and CleanRL's loop with the wrappers,
networks and hyperparameters of its `ppo_continuous_action.py`. All learn the direct task by PPO in the environment of
the preset; evaluations, on its validation plants, do not count. SBX is skipped where it is not installed.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from benchmarks.measurement import OutputArgs, machine
from capsule_gym.command_line import Count, parse

COMMAND = "python -m benchmarks.training"


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Processor time until an agent moves the capsule at 15 cm/s, for several trainers.

    Examples:
      python -m benchmarks.training --markdown docs/speed_training.md
    """

    seeds: Count = 3
    """Training seeds, from 0 on."""
    speed: float = 15.0
    """Mean speed on validation plants that ends a training, cm/s."""
    seconds: float = 900.0
    """Processor time after which a training is given up, s."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    # torch takes seconds to import.
    import torch

    from benchmarks.trainers import CONTENDERS, Clock, train_sbx

    torch.set_num_threads(1)
    rows = [["trainer", *(f"seed {seed}, s" for seed in range(args.seeds)), "thousands of steps"]]
    for name, train in CONTENDERS.items():
        if train is train_sbx and find_spec("sbx") is None:
            print("SBX is skipped: pip install sbx-rl", file=sys.stderr)
            continue
        clocks = []
        for seed in range(args.seeds):
            clock = Clock(seed, args.speed, args.seconds)
            train(seed, clock)
            reached = clock.speed >= args.speed
            text = f"{clock.seconds:.0f}" if reached else f"> {clock.seconds:.0f} ({clock.speed:.1f} cm/s)"
            print(f"{name}, seed {seed}: {text} s", file=sys.stderr, flush=True)
            clocks.append((text, f"{1e-3 * clock.steps:.0f}"))
        rows.append([name, *(text for text, _ in clocks), ", ".join(steps for _, steps in clocks)])
    note = (
        f"Processor time, without evaluations, until the mean speed on validation plants is {args.speed:g} cm/s; > "
        f"where it was not, with the last speed. Direct torque, PPO, one thread of torch. {machine()}."
    )
    args.report(COMMAND, rows, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
