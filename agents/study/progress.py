"""How far the runs of a study have come, as a table on the terminal, out of what they write."""

from __future__ import annotations

import contextlib
import csv
import shutil
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TextIO

from agents.study.jobs import Job
from agents.training.presets import LOG, LOGGED, LOGS
from agents.training.stopping import Stop
from baselines.tables import text_table

# Between two tables, s: redrawn in place on a terminal, one below the other in a file.
ON_TERMINAL, IN_FILE = 1.0, 60.0
# Of the end of a log, in which its last line lies.
TAIL = 8192


def last_row(path: Path) -> dict[str, str]:
    """The last whole line of a CSV file by its columns; empty where there is none."""
    try:
        with path.open("rb") as file:
            header = file.readline()
            begin = file.tell()
            file.seek(0, 2)
            file.seek(max(begin, file.tell() - TAIL))
            whole = file.read().rpartition(b"\n")[0]
    except FileNotFoundError:
        return {}
    if not whole:
        return {}
    columns, values = csv.reader([line.decode(errors="replace") for line in (header, whole.rpartition(b"\n")[2])])
    return dict(zip(columns, values, strict=True)) if len(columns) == len(values) else {}


def number(text: str | None) -> float | None:
    """A number out of a cell; None out of an empty one."""
    try:
        return float(text) if text else None
    except ValueError:
        return None


class Meter:
    """How far a run has come and how fast it is.

    Attributes:
        steps: agent steps so far.
        mean_speed: of the last episodes while training, cm/s; None while there is none.
        failed: share of them that failed.
        rate: agent steps per second since the study began; None while it is not known.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.steps = 0
        self.mean_speed: float | None = None
        self.failed: float | None = None
        self.rate: float | None = None
        self._logged = 0.0
        self._first: tuple[float, float] | None = None

    @property
    def left(self) -> int:
        """Agent steps that are missing."""
        return 0 if self.job.finished else max(0, self.job.config.total_steps - self.steps)

    def look(self) -> None:
        """Reads the run's log."""
        row = last_row(self.job.run / LOGS / LOG)
        steps = number(row.get(LOGGED))
        if steps is None:
            return
        self.steps = int(steps)
        self.mean_speed, self.failed = (number(row.get(f"episodes/{name}")) for name in ("mean_speed", "failed"))
        now = time.monotonic()
        if self._first is None:
            # What it had logged before may be of another day.
            self._first, self._logged = (now, steps), steps
        elif steps > self._logged:
            since, before = self._first
            if steps > before:
                self.rate = (steps - before) / (now - since)
            self._logged = steps


def brief(seconds: float) -> str:
    """A length of time.

    >>> brief(42.0), brief(600.0), brief(9000.0)
    ('42 s', '10 min', '2.5 h')
    """
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def cell(value: float | None, form: str) -> str:
    """A number as it stands in a table; nothing where it is not known."""
    return "" if value is None else format(value, form)


class Progress:
    """While its block runs, shows the table, and hands the user's wish to stop on.

    Args:
        jobs: the runs that are not finished.
        done: how many are.
        parallel: how many are trained at a time.
        stop: what Ctrl-C sets.
        stop_file: the file that tells the runs to stop.
        stream: where the table goes.
    """

    def __init__(
        self, jobs: Sequence[Job], done: int, parallel: int, stop: Stop, stop_file: Path, stream: TextIO | None = None
    ) -> None:
        self.meters = {job: Meter(job) for job in jobs}
        self.running: set[Job] = set()
        self._done, self._parallel = done, parallel
        self._stop, self._stop_file = stop, stop_file
        self._stream = stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._drawn = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Progress:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def text(self) -> str:
        """The table of the runs that are being trained, and a line about all of them."""
        rows = [["run", "steps", "of", "steps/s", "left", "cm/s", "failed"]]
        finished, training = self._done, 0
        for job, meter in self.meters.items():
            if job.finished:
                finished += 1
            elif meter.rate is not None:
                training += 1
                rows.append(
                    [
                        job.name,
                        f"{meter.steps:,}",
                        f"{job.config.total_steps:,}",
                        f"{meter.rate:,.0f}",
                        brief(meter.left / meter.rate),
                        cell(meter.mean_speed, ".2f"),
                        cell(meter.failed, ".1%"),
                    ]
                )
        line = f"{finished} of {self._done + len(self.meters)} runs finished, {training} in training"
        left = self.seconds_left()
        line += f", about {brief(left)} left" if left is not None else ""
        return (f"{text_table(rows, left=1)}\n" if training else "") + line

    def seconds_left(self) -> float | None:
        """The time that all runs still take, each at the mean rate of those of its row; None while none is known."""
        rates: dict[str, list[float]] = {}
        for job, meter in self.meters.items():
            if meter.rate is not None:
                rates.setdefault(job.row, []).append(meter.rate)
        if not rates:
            return None
        known = [rate for row in rates.values() for rate in row]
        lengths = []
        for job, meter in self.meters.items():
            of_row = rates.get(job.row, known)
            lengths.append(meter.left / (sum(of_row) / len(of_row)))
        return max(sum(lengths) / self._parallel, max(lengths))

    def _watch(self) -> None:
        drawn_at = float("-inf")
        while not self._ended.wait(0.2):
            if self._stop.requested:
                self._stop_file.touch()
            if time.monotonic() - drawn_at >= (ON_TERMINAL if self._terminal else IN_FILE):
                drawn_at = time.monotonic()
                self._draw()
        self._draw()

    def _draw(self) -> None:
        for meter in self.meters.values():
            # A log that is being rewritten is whole the next time.
            with contextlib.suppress(OSError):
                meter.look()
        text = self.text()
        if self._terminal:
            columns = shutil.get_terminal_size().columns
            lines = [line[: columns - 1] for line in text.split("\n")]
            # Up to where the last table began, and away with it.
            erased = f"\033[{self._drawn}A\r\033[J" if self._drawn else ""
            text = erased + "\n".join(lines)
            self._drawn = len(lines)
        with contextlib.suppress(OSError):
            print(text, file=self._stream, flush=True)
