"""What the benchmarks share: output files, the description of the machine, and rates that are measured in turns.

Absolute numbers do not carry from machine to machine; the ratios of one run do. Contenders take turns, so that other
work of the machine affects all of them alike, and the median of the turns counts.
"""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tqdm import tqdm

from capsule_gym.command_line import check_output
from capsule_gym.files import replacing, to_json, write_atomically

PACKAGES = ("capsule-gym", "numba", "numpy", "gymnasium")
# Dots per inch of a chart: half as many bytes as at the resolution of the paper's figures.
RESOLUTION = 130
CALIBRATION_SECONDS = 0.05


@dataclass(frozen=True, kw_only=True)
class OutputArgs:
    """The arguments of every benchmark."""

    json: Path | None = None
    """Write the numbers to this new file."""
    markdown: Path | None = None
    """Write the tables to this file."""
    overwrite: bool = False
    """Let --json replace an existing file."""

    def check(self) -> None:
        """Raises an error for files that cannot be written, before the measurement starts.

        Raises:
            ValueError: if a file cannot be written.
        """
        check_output("--json", self.json, overwrite=self.overwrite)
        check_output("--markdown", self.markdown, overwrite=True)
        check_output("--figure", getattr(self, "figure", None), overwrite=True)
        for name in ("turns", "seconds", "trajectories", "total_steps"):
            value = getattr(self, name, 1)
            if not value > 0:
                raise ValueError(f"--{name.replace('_', '-')} must be above 0, got {value:g}")

    def write(self, command: str, numbers: dict[str, Any], lines: Sequence[str]) -> None:
        """Writes the files that were asked for.

        Args:
            command: named in the first line of the page.
            numbers: content of --json.
            lines: content of --markdown.
        """
        if self.json is not None:
            write_atomically(self.json, to_json(numbers))
        if self.markdown is not None:
            header = f"<!-- Written by {command}: do not edit. -->"
            write_atomically(self.markdown, "\n".join([header, "", *lines, ""]))


def save_figure(figure: Any, path: Path) -> None:
    """Writes a matplotlib figure as PNG, atomically."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=RESOLUTION, metadata={"Software": None})


def section(name: str, lines: Sequence[str]) -> list[str]:
    """Lines that other pages include by the page's path and this name."""
    return [f"<!-- --8<-- [start:{name}] -->", *lines, f"<!-- --8<-- [end:{name}] -->", ""]


def available_cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine(*packages: str) -> dict[str, Any]:
    """Processor, cores, load and versions.

    Args:
        packages: whose versions are added to those of `PACKAGES`; one that is not installed is left out.
    """
    versions = {}
    for package in (*PACKAGES, *packages):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": names[0] if names else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "cores_available": available_cores(),
        "load_at_start": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.system(),
        "python": platform.python_version(),
        "versions": versions,
    }


def describe(found: dict[str, Any]) -> str:
    """`machine()` in one line."""
    versions = ", ".join(f"{package} {number}" for package, number in found["versions"].items())
    cores = f"{found['cores_available']} of {found['cores']} cores"
    return f"{found['cpu']}, {cores}, {found['system']}, Python {found['python']}, {versions}"


@dataclass(frozen=True)
class Stepper:
    """Environments that are ready to be stepped.

    Attributes:
        step: takes a number of steps of all environments.
        close: frees them.
        reset_seconds: duration of the reset of all environments; None where it was not measured.
    """

    step: Callable[[int], None]
    close: Callable[[], None]
    reset_seconds: float | None = None


@dataclass(frozen=True)
class Contender:
    """A way to step environments whose rate is measured.

    Attributes:
        label: for the tables.
        make: makes the environments.
        environments: number of environments.
        substeps: integration steps in one step of the environment.
        threads: number of threads that share the environments.
        peer: name of the contender that the ratio refers to.
        packages: what must be installed besides this package.
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
        """The label with batch and threads: unique among the contenders."""
        batch = f", {self.environments} environments" if self.environments > 1 else ""
        return f"{self.label}{batch}{f', {self.threads} threads' if self.threads > 1 else ''}"


@dataclass(frozen=True)
class Rate:
    """Median and quartiles of the steps per second over the turns, and the duration of the reset before them."""

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


def select_available(contenders: Sequence[Contender], cores: int) -> tuple[list[Contender], list[str]]:
    """The contenders that this machine can measure, and a line for each reason why others are left out."""
    found: list[Contender] = []
    missing: dict[str, list[str]] = {}
    for contender in contenders:
        lacking = [package for package in contender.packages if find_spec(package) is None]
        if lacking:
            reason = f'{", ".join(lacking)} not installed: pip install "capsule-gym[bench]"'
            missing.setdefault(reason, []).append(contender.label)
        elif contender.threads > cores:
            reason = f"{contender.threads} threads need as many cores, {cores} may be used"
            missing.setdefault(reason, []).append(contender.label)
        else:
            found.append(contender)
    return found, [f"Left out ({reason}): {'; '.join(dict.fromkeys(labels))}." for reason, labels in missing.items()]


def _steps_per_turn(stepper: Stepper, seconds: float) -> int:
    """The number of steps that takes about so many seconds; compiles and warms up on the way."""
    stepper.step(1)
    count = 1
    while True:
        start = time.perf_counter()
        stepper.step(count)
        elapsed = time.perf_counter() - start
        if elapsed >= CALIBRATION_SECONDS:
            return max(1, round(count * seconds / elapsed))
        count *= 2


def measure(contenders: Sequence[Contender], turns: int, seconds: float) -> dict[str, Rate]:
    """The rates of all contenders, by name.

    Args:
        contenders: at least one.
        turns: number of turns of each contender, one after the other.
        seconds: length of a turn, at least one step.
    """
    steppers: list[tuple[Contender, Stepper, int]] = []
    rates: dict[str, list[float]] = {contender.name: [] for contender in contenders}
    try:
        for contender in tqdm(contenders, desc="preparing"):
            stepper = contender.make()
            steppers.append((contender, stepper, _steps_per_turn(stepper, seconds)))
        for _ in tqdm(range(turns), desc="turns"):
            for contender, stepper, count in steppers:
                start = time.perf_counter()
                stepper.step(count)
                rates[contender.name].append(count * contender.environments / (time.perf_counter() - start))
    finally:
        for _, stepper, _ in steppers:
            stepper.close()
    return {contender.name: Rate.of(rates[contender.name], stepper.reset_seconds) for contender, stepper, _ in steppers}
