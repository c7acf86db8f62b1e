"""The command line: `python -m tests.faults`."""

from __future__ import annotations

import itertools
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from capsule_gym.command_line import Count, parse

Fault = Literal["kill", "stop", "disk", "readonly", "processes", "cache", "fork"]


@dataclass(frozen=True)
class Args:
    """Injects faults of a machine into trainings and caches, and reports what is lost.

    Examples:
      python -m tests.faults --short
      python -m tests.faults --fault kill stop --kills 20
    """

    fault: tuple[Fault, ...] = ("kill", "stop", "disk", "readonly", "processes", "cache", "fork")
    """The faults."""
    kills: Count = 100
    """Times that a training is killed; signals stop it half as often."""
    short: bool = False
    """What CI runs: each fault once or a few times."""
    seed: Count = 0
    """Seed of the moments."""


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if something broke."""
    args = parse(Args, "python -m tests.faults", arguments)
    # After the options, so that the help comes without torch.
    from tqdm import tqdm

    from tests.faults.run import Faults, plan

    with tempfile.TemporaryDirectory(prefix="faults-") as folder, tqdm(unit=" faults") as bar:
        faults = Faults(Path(folder), 5 if args.short else 12, args.seed)
        for name in itertools.chain.from_iterable(plan(faults, args)):
            faults.tried[name] = faults.tried.get(name, 0) + 1
            bar.update()
    for message in faults.broken:
        print(f"\n{message}", file=sys.stderr)
    for name, tried in faults.tried.items():
        print(f"{name:48} {tried:4d} times")
    print(f"{len(faults.broken)} broken; at most {faults.lost} steps were trained again.")
    return 1 if faults.broken else 0


if __name__ == "__main__":
    sys.exit(main())
