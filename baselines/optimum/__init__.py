"""The optimum of the direct-torque task by dynamic programming: `python -m baselines.optimum` computes it."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from baselines.optimum.cycles import Cycle, cycle
    from baselines.optimum.records import optimal_speed

__all__ = ["Cycle", "cycle", "optimal_speed"]

# N: the observation is coarser than the state, so that less may be none.
LEAST_CONTACT = 0.02
# Of what is computed.
FOLDER = Path(__file__).with_name("data")

_LAZY = {
    "Cycle": ".cycles",
    "cycle": ".cycles",
    "optimal_speed": ".records",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LAZY[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
