"""Output, the description of the machine, and measurements in turns.

Ratios within one run are comparable between machines; absolute numbers are not.
"""

import os
import platform
import re
from collections.abc import Callable, Mapping
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from tqdm import tqdm

from baselines.tables import Rows, markdown_table, text_table
from capsule_gym.core import native
from capsule_gym.files import write_atomically

PACKAGES = ("capsule-gym", "numpy", "gymnasium", "mujoco")
# Vectors that the core uses, by its levels of instructions.
VECTORS = {"v4": " with AVX-512", "v3": " with AVX2"}


def report(command: str, markdown: Path | None, *parts: str | Rows) -> None:
    """Prints paragraphs and tables, and writes them to a page if one is given."""
    printed = []
    written = [f"<!-- Written by {command}: do not edit. -->"]
    for part in parts:
        if isinstance(part, str):
            printed.append(part)
            written.append(part)
        else:
            printed.append(text_table(part, left=1))
            written.append(markdown_table(part))
    print(*printed, sep="\n\n")
    if markdown is not None:
        write_atomically(markdown, "\n\n".join(written) + "\n")


def machine() -> str:
    """One line with the processor, the vectors of the core, cores, and versions of packages."""
    vectors = VECTORS.get(native.LEVEL, "")
    parts = [f"{processor()}{vectors}", f"{os.cpu_count()} cores", platform.system()]
    parts.append(f"Python {platform.python_version()}")
    for name in PACKAGES:
        if find_spec(name.replace("-", "_")):
            parts.append(f"{name} {version(name)}")
    return ", ".join(parts)


def processor() -> str:
    """The name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        found = re.search(r"model name[^:\n]*:(.*)", info.read_text(encoding="utf-8"))
        if found and found[1].strip():
            return found[1].strip()
    return platform.processor() or platform.machine()


def rates(contenders: Mapping[str, Callable[[], float]], turns: int) -> dict[str, float]:
    """Rates, 1/s, at the 10th percentiles of seconds."""
    seconds = in_turns(contenders, turns)
    return {name: 1.0 / float(np.percentile(each, 10.0)) for name, each in seconds.items()}


def in_turns(contenders: Mapping[str, Callable[[], float]], turns: int) -> dict[str, list[float]]:
    """The results of contenders, which take turns, so that other processes affect all alike."""
    found: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in tqdm(range(turns), desc="turns"):
        for name, turn in contenders.items():
            found[name].append(turn())
    return found
