"""Processes that run cases, of which any may end or hang."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

# Far above what any case takes, compilation on a busy machine included.
HANG_SECONDS = 180.0
# Nobody reads more.
MOST_FAILURES = 100
CONTEXT = multiprocessing.get_context("forkserver")

# Runs a case; returns its agent steps, and what is wrong in words.
Run = Callable[[int], tuple[int, str | None]]


@dataclass
class Tally:
    """What the cases have come to.

    Attributes:
        steps: agent steps.
        cases: finished.
        failures: by case, in words.
        stopped: whether the user has ended it.
    """

    steps: int = 0
    cases: int = 0
    failures: dict[int, str] = field(default_factory=dict)
    stopped: bool = False


def _work(pipe: Connection, run: Run) -> None:
    """Runs cases as it is told, for ever."""
    # A process that ends says where it stood.
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError):
        pipe.send("ready")
        while True:
            pipe.send(run(pipe.recv()))


class Worker:
    """A process, and the case that it runs.

    Args:
        run: runs a case there.
    """

    def __init__(self, run: Run) -> None:
        self.pipe, theirs = CONTEXT.Pipe()
        self.process: Any = CONTEXT.Process(target=_work, args=(theirs, run), daemon=True)
        self.process.start()
        theirs.close()
        # What it imports before that is no part of a case.
        self.pipe.recv()

    def begin(self, number: int) -> None:
        """Hands it a case."""
        self.number, self.since = number, time.monotonic()
        # One that has ended is met when it should answer.
        with suppress(BrokenPipeError):
            self.pipe.send(number)

    def end(self) -> None:
        """Ends the process; says on stderr where it stands, if it still runs."""
        if self.process.is_alive():
            os.kill(self.process.pid, signal.SIGABRT)
        self.process.join(5.0)
        self.process.kill()
        self.pipe.close()


def fuzz(
    run: Run,
    steps: int,
    workers: int,
    first: int = 0,
    *,
    hang_seconds: float = HANG_SECONDS,
    tell: Callable[[Tally], object] = lambda tally: None,
) -> Tally:
    """Runs cases until so many agent steps are done, or too much is broken.

    Args:
        run: runs a case; a function of a module.
        steps: agent steps in all.
        workers: processes.
        first: number of the first case.
        hang_seconds: what no case takes.
        tell: is called after each case.
    """
    tally, following = Tally(), first
    busy: list[Worker] = []

    def begin(worker: Worker) -> None:
        nonlocal following
        worker.begin(following)
        following += 1
        busy.append(worker)

    def note(worker: Worker, done: int, failure: str | None) -> None:
        busy.remove(worker)
        tally.cases += 1
        tally.steps += done
        if failure is not None:
            tally.failures[worker.number] = failure
        tell(tally)

    try:
        for _ in range(workers):
            begin(Worker(run))
        while tally.steps < steps and len(tally.failures) < MOST_FAILURES:
            ready = wait([worker.pipe for worker in busy], timeout=1.0)
            for worker in list(busy):
                if worker.pipe in ready:
                    try:
                        note(worker, *worker.pipe.recv())
                    except (EOFError, ConnectionResetError):
                        worker.end()
                        note(worker, 0, f"ends the interpreter (exit status {worker.process.exitcode})")
                        worker = Worker(run)
                elif time.monotonic() - worker.since > hang_seconds:
                    worker.end()
                    note(worker, 0, f"hangs: no answer in {hang_seconds:g} s")
                    worker = Worker(run)
                else:
                    continue
                begin(worker)
    except KeyboardInterrupt:
        tally.stopped = True
    finally:
        for worker in busy:
            worker.process.kill()
    return tally
