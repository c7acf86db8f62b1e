"""Rates of contenders that take turns.

Absolute numbers do not carry from machine to machine; the ratios of one run do. Contenders take turns, so that
whatever else the machine does meets them all, and the median of the turns counts.
"""

from __future__ import annotations

import importlib
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

CALIBRATION_SECONDS = 0.05


@dataclass(frozen=True)
class Stepper:
    """Environments that are ready to be stepped.

    Attributes:
        step: takes a number of steps of all of them.
        close: frees them.
        reset_seconds: what the reset of all of them took; None where it was not measured.
    """

    step: Callable[[int], None]
    close: Callable[[], None]
    reset_seconds: float | None = None


@dataclass(frozen=True)
class Contender:
    """Something that steps.

    Attributes:
        label: what it is.
        make: makes it ready.
        environments: how many it steps at once.
        substeps: steps of the integrator in one step of the environment.
        threads: threads that share them.
        peer: name of the contender that its ratio is to.
        packages: what must be installed beside this package.
    """

    label: str
    make: Callable[[], Stepper]
    environments: int = 1
    substeps: int = 1
    threads: int = 1
    peer: str | None = None
    packages: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The label with batch and threads: no two contenders share it."""
        batch = f", {self.environments} environments" if self.environments > 1 else ""
        return f"{self.label}{batch}{f', {self.threads} threads' if self.threads > 1 else ''}"


@dataclass(frozen=True)
class Rate:
    """Environment steps per second over the turns, with the seconds of the reset before them."""

    median: float
    low: float
    high: float
    reset_seconds: float | None = None

    @classmethod
    def of(cls, rates: Sequence[float], reset_seconds: float | None = None) -> Rate:
        """Median and quartiles of the turns."""
        low, median, high = statistics.quantiles(rates, n=4, method="inclusive") if len(rates) > 1 else [*rates] * 3
        return cls(median, low, high, reset_seconds)

    @property
    def spread(self) -> float:
        """The interquartile range over the median."""
        return (self.high - self.low) / self.median


class Progress:
    """Lines on stderr that say how far a stage is and how long it will go on.

    Args:
        stage: its name.
        total: how many parts it has.
    """

    def __init__(self, stage: str, total: int) -> None:
        self.stage, self.total, self.done = stage, total, 0
        self.start = time.perf_counter()

    def step(self, what: str = "") -> None:
        """Counts one part as done."""
        self.done += 1
        elapsed = time.perf_counter() - self.start
        left = elapsed / self.done * (self.total - self.done)
        line = (
            f"{self.stage}: {self.done}/{self.total}{f', {what}' if what else ''}, {elapsed:.0f} s, {left:.0f} s left"
        )
        print(line, file=sys.stderr, flush=True)


def _is_importable(package: str) -> bool:
    try:
        importlib.import_module(package)
    except ImportError:
        return False
    return True


def present(contenders: Iterable[Contender], cores: int) -> tuple[list[Contender], list[str]]:
    """The contenders that this machine can measure, and a line for each reason why others are left out.

    Args:
        contenders: all of them.
        cores: cores that may be used.
    """
    found: list[Contender] = []
    missing: dict[str, dict[str, None]] = {}  # a set that keeps its order
    for contender in contenders:
        lacking = [package for package in contender.packages if not _is_importable(package)]
        reason = f'{", ".join(lacking)} not installed: pip install "capsule-gym[bench]"' if lacking else ""
        if not reason and contender.threads > cores:
            reason = f"{contender.threads} threads need as many cores, {cores} may be used"
        if reason:
            missing.setdefault(reason, {})[contender.label] = None
        else:
            found.append(contender)
    return found, [f"Left out ({reason}): {'; '.join(labels)}." for reason, labels in missing.items()]


def _steps_per_turn(stepper: Stepper, seconds: float) -> int:
    """How many steps take about that long; compiles and warms up on the way."""
    stepper.step(1)
    count = 1
    while True:
        start = time.perf_counter()
        stepper.step(count)
        elapsed = time.perf_counter() - start
        if elapsed >= CALIBRATION_SECONDS:
            return max(1, round(count * seconds / elapsed))
        count *= 2


def measure(contenders: Sequence[Contender], turns: int, seconds: float, stage: str) -> dict[str, Rate]:
    """The rates of all contenders, by name.

    Args:
        contenders: at least one.
        turns: turns that each takes, one after the other.
        seconds: length of a turn, one step at least.
        stage: name for the progress.
    """
    progress = Progress(f"{stage}, preparing", len(contenders))
    steppers: list[tuple[Contender, Stepper, int]] = []
    try:
        for contender in contenders:
            stepper = contender.make()
            steppers.append((contender, stepper, _steps_per_turn(stepper, seconds)))
            progress.step(contender.name)
        rates: dict[str, list[float]] = {contender.name: [] for contender in contenders}
        progress = Progress(f"{stage}, turns", turns)
        for _ in range(turns):
            for contender, stepper, count in steppers:
                start = time.perf_counter()
                stepper.step(count)
                rates[contender.name].append(count * contender.environments / (time.perf_counter() - start))
            progress.step()
    finally:
        for _, stepper, _ in steppers:
            stepper.close()
    return {contender.name: Rate.of(rates[contender.name], stepper.reset_seconds) for contender, stepper, _ in steppers}
