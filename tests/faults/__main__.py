"""The command line: `python -m tests.faults`."""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from agents.training.signals import INTERRUPTED
from capsule_gym.command_line import Count, parse

Fault = Literal["kill", "stop", "disk", "readonly", "processes", "cache", "fork"]


@dataclass(frozen=True)
class Options:
    """Breaks trainings and caches in every way a machine can, and counts what is lost.

    Examples:
      python -m tests.faults --short
      python -m tests.faults --fault kill stop --kills 20
    """

    fault: tuple[Fault, ...] = ("kill", "stop", "disk", "readonly", "processes", "cache", "fork")
    """Which of them."""

    kills: Count = 100
    """Times that a training is killed; signals stop it half as often."""

    short: bool = False
    """What CI runs: each fault once or a few times."""

    seed: Count = 0
    """Of the moments."""

    jobs: Count = 2
    """Faults that are tried side by side."""

    def check(self) -> None:
        """Refuses numbers that try nothing."""
        for name in ("kills", "jobs"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name} must be >= 1, got {getattr(self, name)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 where something broke."""
    options = parse(Options, "python -m tests.faults", arguments)
    # After the command line is known to be right: the help needs none of it.
    from tests.faults.bench import INTERVAL, Bench, table
    from tests.faults.plan import Plan
    from tests.faults.processes import CONTEXT, PRELOADED

    CONTEXT.set_forkserver_preload(PRELOADED)
    plan = Plan(options)
    began = time.monotonic()
    stopped = threading.Event()

    def tick(trials: int = 1) -> None:
        bar.update(trials)
        if stopped.is_set():
            raise CancelledError

    with tempfile.TemporaryDirectory(prefix="faults-") as folder, tqdm(total=plan.total, unit=" faults") as bar:
        bench = Bench(Path(folder), 5 if options.short else 12, options.seed, tick)
        pool = ThreadPoolExecutor(options.jobs)
        running = [pool.submit(trial, bench) for trial in plan.trials]
        try:
            for each in running:
                each.result()
        except KeyboardInterrupt:
            stopped.set()
            tqdm.write("Stopping after what is being tried.", file=sys.stderr)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for outcome in plan.outcomes:
        for message in outcome.broken:
            print(f"\n{message}", file=sys.stderr)
    intervals = " and ".join(f"{steps} steps ({algo.upper()})" for algo, steps in INTERVAL.items())
    print(f"\n{table(plan.outcomes)}\n\nA checkpoint every {intervals}; {time.monotonic() - began:.0f} s in all.")
    if stopped.is_set():
        print("Stopped: this is what was tried until then.")
        return INTERRUPTED
    return 1 if any(outcome.broken for outcome in plan.outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
