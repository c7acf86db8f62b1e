"""The command line: `python -m tests.fuzz`."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass

from tqdm import tqdm

from agents.training.stopping import INTERRUPTED
from capsule_gym.command_line import Count, parse
from tests.fuzz.workers import CONTEXT, Tally, fuzz

SHORT_STEPS = 500_000


@dataclass(frozen=True)
class Options:
    """Throws arguments, options, states and actions at the environments until something breaks.

    Examples:
      python -m tests.fuzz --short
      python -m tests.fuzz --first 1000 --steps 1e7
    """

    steps: Count = 1_000_000
    """Agent steps, over all environments."""

    short: bool = False
    """What CI runs: half of that."""

    first: Count = 0
    """Number of the first case: other numbers, other cases."""

    jobs: Count = os.cpu_count() or 1
    """Processes."""

    replay: int | None = None
    """Run this case alone, in this process, and show its calls."""

    def check(self) -> None:
        """Refuses to run nothing."""
        for name in ("steps", "jobs"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name} must be >= 1, got {getattr(self, name)}")


def replay(number: int) -> int:
    """Runs one case; returns the exit status."""
    from tests.fuzz.cases import Case

    case = Case(number)
    try:
        case.run()
    except Exception:
        traceback.print_exc()
        print(f"\n{case.told(10)}", file=sys.stderr)
        return 1
    print(f"Case {number}: {case.steps} steps, nothing broke.")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 where something broke."""
    options = parse(Options, "python -m tests.fuzz", arguments)
    # After the command line is known to be right: the help needs none of it.
    from tests.fuzz.cases import run

    if options.replay is not None:
        return replay(options.replay)
    CONTEXT.set_forkserver_preload(["tests.fuzz.cases"])
    began = time.monotonic()
    steps = min(options.steps, SHORT_STEPS) if options.short else options.steps
    with tqdm(total=steps, unit=" steps", unit_scale=True) as bar:

        def tell(tally: Tally) -> None:
            bar.set_postfix_str(f"{tally.cases} cases, {len(tally.failures)} failures", refresh=False)
            bar.update(min(tally.steps, steps) - bar.n)

        tally = fuzz(run, steps, options.jobs, options.first, tell=tell)
    for number, failure in sorted(tally.failures.items()):
        print(f"case {number}: {failure}")
    print(
        f"\n{tally.steps:,} steps in {tally.cases:,} cases, {len(tally.failures)} failures; "
        f"{time.monotonic() - began:.0f} s"
    )
    if tally.stopped:
        print("Stopped: this is what was tried until then.")
        return INTERRUPTED
    return 1 if tally.failures else 0


if __name__ == "__main__":
    sys.exit(main())
