"""The command line: `python -m tests.faults`."""

from __future__ import annotations

import random
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from agents.training.stopping import INTERRUPTED
from capsule_gym.command_line import Count, parse
from tests.faults import compiled, disks
from tests.faults.bench import INTERVAL, TINY, Bench, Outcome, table
from tests.faults.processes import CONTEXT, PRELOADED
from tests.faults.trainings import MOMENTS, disturb, drawn

Fault = Literal["kill", "stop", "disk", "readonly", "processes", "cache", "fork"]
Trial = Callable[[Bench], None]


@dataclass(frozen=True)
class Options:
    """Breaks trainings and caches in every way a machine can, and counts what is lost.

    Examples:
      python -m tests.faults --short
      python -m tests.faults --fault kill stop --kills 20
    """

    fault: tuple[Fault, ...] = ("kill", "stop", "disk", "readonly", "processes", "cache", "fork")
    """which of them"""

    kills: Count = 100
    """times that a training is killed; signals stop it half as often"""

    short: bool = False
    """what CI runs: each fault once or a few times"""

    seed: Count = 0
    """of the moments"""

    workers: Count = 2
    """faults that are tried side by side"""

    def check(self) -> None:
        """Refuses numbers that try nothing."""
        for name in ("kills", "workers"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name} must be >= 1, got {getattr(self, name)}")


class Plan:
    """What is tried.

    Attributes:
        trials: functions that try a fault on a bench.
        outcomes: what they come to, in order of the table.
        total: the number of ticks.
    """

    def __init__(self, options: Options) -> None:
        self.trials: list[Trial] = []
        self.outcomes: list[Outcome] = []
        self.total = 0
        self._faults = options.fault
        self._add_trainings(options)
        short = options.short
        self._add("disk", "a file that may not grow", disks.small_files, 2 if short else 10)
        self._add("disk", "a full file system", disks.full_disk, 1 if short else 5)
        self._add("readonly", "a folder that is read-only", disks.read_only, 1 if short else 3)
        self._add("processes", "processes that compile at once", compiled.at_once, 2 if short else 8)
        for how in ("changed by a bit",) if short else ("changed by a bit", "truncated", "garbled"):
            trial = partial(compiled.damaged_cache, how=how)
            self._add("cache", f"a cache that is {how}", trial, 1 if short else 3)
        if not short:
            self._add("cache", "a cache that is emptied on the way", compiled.emptied_cache, 3)
            self._add("cache", "a cache that is read-only", compiled.read_only_cache, 2)
        self._add("fork", "fork after use", compiled.forks, 2 if short else 10)

    def _add_trainings(self, options: Options) -> None:
        """Adds the kills and the stops, half of them for each algorithm."""
        rng = random.Random(options.seed)
        tries = {"kill": 4 if options.short else options.kills, "stop": 5 if options.short else options.kills // 2}
        moments = [moment for fault in tries if fault in self._faults for moment in drawn(fault, tries[fault], rng)]
        rng.shuffle(moments)
        outcomes = {moment.what: Outcome(moment.what, lost=0) for moment in MOMENTS if moment in moments}
        self.outcomes += outcomes.values()
        self.total += len(moments)
        for i, algo in enumerate(TINY):
            own = moments[i :: len(TINY)]
            self.trials.append(partial(disturb, algo=algo, moments=own, outcomes=outcomes))

    def _add(self, fault: Fault, what: str, trial: Callable[..., None], tries: int) -> None:
        """Adds a fault that is tried so often."""
        if fault in self._faults:
            outcome = Outcome(what)
            self.outcomes.append(outcome)
            self.total += tries
            self.trials.append(partial(trial, outcome=outcome, tries=tries))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 where something broke."""
    options = parse(Options, "python -m tests.faults", arguments)
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
        pool = ThreadPoolExecutor(options.workers)
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
