"""The machine that a measurement was made on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("capsule-gym", "numba", "numpy", "gymnasium")


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine(*packages: str) -> dict[str, Any]:
    """What the numbers were measured on.

    Args:
        packages: whose versions matter beside those of `PACKAGES`; one that is not installed is left out.
    """
    versions = {}
    for package in (*PACKAGES, *packages):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "cpu": _cpu_name(),
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


def _cpu_name() -> str:
    """The model's name where the system tells it, else the architecture."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
