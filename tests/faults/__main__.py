"""The command line: `python -m tests.faults`."""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from capsule_gym.command_line import parse


@dataclass(frozen=True)
class Args:
    """Injects faults of a machine into trainings, and reports the lost steps.

    Examples:
      python -m tests.faults --short
      python -m tests.faults
    """

    short: bool = False
    """What CI runs: each fault once or a few times."""


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if something broke."""
    args = parse(Args, "python -m tests.faults", arguments)
    # Imported after the options are parsed, so that the help does not import torch.
    from tqdm import tqdm

    from tests.faults.run import Faults

    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        faults = Faults(Path(folder), short=args.short)
        tried = Counter(tqdm(faults.inject(), unit=" faults"))
    for message in faults.broken:
        print(f"\n{message}", file=sys.stderr)
    for name, times in tried.items():
        print(f"{name:48} {times:4d} times")
    print(f"{len(faults.broken)} broken; at most {faults.lost} steps were trained again.")
    return 1 if faults.broken else 0


if __name__ == "__main__":
    sys.exit(main())
