"""Dynamic programming for the direct-torque task: `python -m baselines.dynamic_programming` computes the policies."""

from pathlib import Path
from typing import Any

__all__ = ["cycle", "optimal_speed"]

# N: the observation is coarser than the state, so that a smaller predicted force may be none.
MIN_NORMAL_FORCE = 0.02
# Of the archive.
FOLDER = Path(__file__).with_name("data")


def __getattr__(name: str) -> Any:
    """Imports what is exported when it is first used: numba takes most of a second to import."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from baselines.dynamic_programming import archive

    return getattr(archive, name)
