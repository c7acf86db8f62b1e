"""Shared functions of the benchmarks: output files, the description of the machine, and measurements in turns.

Ratios within one run are comparable between machines; absolute numbers are not. Contenders take turns, so that other
processes affect all of them equally, and the median over the turns is used.
"""

from __future__ import annotations

import os
import platform
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

from baselines.tables import Rows, markdown_table, text_table
from capsule_gym import native
from capsule_gym.command_line import check_output
from capsule_gym.files import write_atomically

PACKAGES = ("capsule-gym", "numpy", "gymnasium")
# Vectors that the core uses, by its levels of instructions.
VECTORS = {"v4": "AVX-512", "v3": "AVX2"}

Name = TypeVar("Name")


@dataclass(frozen=True, kw_only=True)
class OutputArgs:
    """The arguments of every benchmark."""

    markdown: Path | None = None
    """Write the table to this file."""

    def check(self) -> None:
        """Raises an error for files that cannot be written, before the measurement starts.

        Raises:
            ValueError: if a file cannot be written.
        """
        check_output("--markdown", self.markdown, overwrite=True)
        if getattr(self, "turns", 1) < 1:
            raise ValueError("--turns must be above 0, got 0")

    def report(self, command: str, *parts: str | Rows, left: int | None = None) -> None:
        """Prints paragraphs and tables (`left` as in `text_table`), and writes the page if it was requested."""
        print(*(part if isinstance(part, str) else text_table(part, left=left) for part in parts), sep="\n\n")
        self.write(command, *(part if isinstance(part, str) else markdown_table(part) for part in parts))

    def write(self, command: str, *paragraphs: str) -> None:
        """Writes the page if it was requested.

        Args:
            command: the command, for the first line.
            *paragraphs: the content.
        """
        if self.markdown is not None:
            header = f"<!-- Written by {command}: do not edit. -->"
            write_atomically(self.markdown, "\n\n".join([header, *paragraphs]) + "\n")


def available_cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine(*packages: str) -> str:
    """One line with the processor, vectors of the core, cores and versions, also of `packages` if installed."""
    versions = []
    for package in (*PACKAGES, *packages):
        try:
            versions.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    cpu = names[0] if names else platform.processor() or platform.machine()
    vectors = [VECTORS[native.LEVEL]] if native.LEVEL in VECTORS else []
    cores = f"{available_cores()} of {os.cpu_count()} cores"
    system = f"{platform.system()}, Python {platform.python_version()}"
    return ", ".join([" with ".join([cpu, *vectors]), cores, system, *versions])


def take_turns(contenders: Mapping[Name, Callable[[], float]], turns: int) -> dict[Name, list[float]]:
    """Runs all contenders in turns; returns their rates by name, one number per turn."""
    rates: dict[Name, list[float]] = {name: [] for name in contenders}
    for _ in tqdm(range(turns), desc="turns"):
        for name, turn in contenders.items():
            rates[name].append(turn())
    return rates


def spread(rates: Sequence[float]) -> float:
    """The interquartile range divided by the median."""
    low, median, high = statistics.quantiles(rates, n=4, method="inclusive") if len(rates) > 1 else [*rates] * 3
    return (high - low) / median
