"""What `python -m tests.faults` tries."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from tests.faults import compiled, disks
from tests.faults.bench import TINY, Bench, Outcome
from tests.faults.trainings import MOMENTS, disturb, drawn

if TYPE_CHECKING:
    from tests.faults.__main__ import Fault, Options

Trial = Callable[[Bench], None]


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
