"""Trainings that are killed and stopped."""

from __future__ import annotations

import random
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.training import checkpoint
from agents.training.presets import LOGGED
from agents.training.signals import INTERRUPTED
from tests.agents.training.small import rows
from tests.faults.bench import INTERVAL, Bench, Outcome
from tests.faults.processes import Child

KILL, TERM, INT = signal.SIGKILL, signal.SIGTERM, signal.SIGINT


@dataclass(frozen=True)
class Moment:
    """When a training is disturbed, and how.

    Attributes:
        fault: "kill" or "stop".
        what: in words.
        when: "training", "writing", "starting", "importing" or "compiling".
        signals: one of which it is sent; both, if they are the same.
        share: of the fault's trials.
    """

    fault: str
    what: str
    when: str
    signals: tuple[signal.Signals, ...]
    share: float


MOMENTS = (
    Moment("kill", "kill -9 after a checkpoint", "training", (KILL,), 0.60),
    Moment("kill", "kill -9 while a checkpoint is written", "writing", (KILL,), 0.25),
    Moment("kill", "kill -9 at the start", "starting", (KILL,), 0.15),
    Moment("stop", "SIGTERM or Ctrl-C while training", "training", (TERM, INT), 0.40),
    Moment("stop", "SIGTERM or Ctrl-C while a checkpoint is written", "writing", (TERM, INT), 0.20),
    Moment("stop", "Ctrl-C twice", "training", (INT, INT), 0.15),
    Moment("stop", "SIGTERM or Ctrl-C while importing", "importing", (TERM, INT), 0.15),
    Moment("stop", "SIGTERM or Ctrl-C while compiling", "compiling", (TERM, INT), 0.10),
)


def drawn(fault: str, total: int, rng: random.Random) -> list[Moment]:
    """About so many moments of a fault, each kind at least once, in random order."""
    moments = [m for m in MOMENTS if m.fault == fault for _ in range(max(1, round(total * m.share)))]
    rng.shuffle(moments)
    return moments


def disturb(bench: Bench, algo: str, moments: Sequence[Moment], outcomes: Mapping[str, Outcome]) -> None:
    """Disturbs trainings, each several times, and compares them at their ends."""
    run = bench.new(algo)
    for n, moment in enumerate(moments):
        outcome = outcomes[moment.what]
        if steps_of(run) >= (bench.intervals - 3) * INTERVAL[algo]:
            bench.finish(algo, run, outcome)
            run = bench.new(algo)
        child = launch(bench, algo, run, moment)
        await_moment(bench, child, run, moment)
        if len(set(moment.signals)) == 1:
            for number in moment.signals:
                child.send(number)
                time.sleep(0.05)
        else:
            child.send(moment.signals[n % 2])
        judge(child, run, moment, outcome, INTERVAL[algo])
        outcome.tried += 1
        bench.tick()
    if moments:
        bench.finish(algo, run, outcomes[moments[-1].what])


def launch(bench: Bench, algo: str, run: Path, moment: Moment) -> Child:
    """Begins the training that is to be disturbed, or goes on with it."""
    if moment.when == "importing":
        return Child(bench.new("log"), None, sys.executable, "train.py", *bench.arguments(algo, run))
    return bench.train(algo, run, cache=str(bench.new("cache")) if moment.when == "compiling" else "")


def await_moment(bench: Bench, child: Child, run: Path, moment: Moment) -> None:
    """Waits for a moment."""
    first, now = steps_of(run), time.time()
    conditions = {
        "training": (lambda: steps_of(run) > first, 0.5),
        "writing": (lambda: written_since(run, now), 0.02),
        "starting": (child.handles_signals, 1.5),
        "importing": (child.handles_signals, 3.0),
        "compiling": (lambda: "compiling" in child.printed(), 4.0),
    }
    condition, longest = conditions[moment.when]
    child.wait(condition)
    child.wait(seconds=bench.rng.uniform(0.0, longest))


def written_since(run: Path, then: float) -> bool:
    """Whether a checkpoint is being written, not one that was never finished."""
    try:
        return any(path.stat().st_mtime > then for path in run.glob(f"*{checkpoint.PARTIAL}"))
    except FileNotFoundError:
        return False


def judge(child: Child, run: Path, moment: Moment, outcome: Outcome, interval: int) -> None:
    """Looks at what a disturbed training has left."""
    status, printed = child.end(), child.printed()
    # 0: it came to its end first.
    expected = (0, -KILL) if moment.signals == (KILL,) else (0, INTERRUPTED)
    outcome.expect(status in expected and "Traceback" not in printed, f"exit status {status}: {printed}")
    for folder in run.glob("checkpoint-????????????"):
        reason = checkpoint.damage(folder)
        outcome.expect(reason is None, f"{folder.name} is damaged: {reason}")
    lost = max(0, logged(run) - steps_of(run))
    outcome.expect(lost <= interval, f"{lost} steps are lost")
    outcome.lost = max(outcome.lost or 0, lost)


def steps_of(run: Path) -> int:
    """Agent steps of the newest checkpoint; 0 without one."""
    newest = checkpoint.newest(run)
    return int(newest.name.split("-")[1]) if newest is not None else 0


def logged(run: Path) -> int:
    """Agent steps that a run had got to, as its log says."""
    try:
        return max((int(row[LOGGED]) for row in rows(run / "logs" / "progress.csv") if row[LOGGED]), default=0)
    except OSError:
        return 0
