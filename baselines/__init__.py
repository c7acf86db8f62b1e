"""The scripted baselines: the paper's trajectories, its control laws and policies made of them.

The functions here are what the environment's argument `controller` takes, as in `controller="baselines:adaptive"`. Each
is imported when it is first asked for, since numba, which takes most of a second, comes with it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from baselines.laws.adaptive import adaptive, adaptive_as_published, compliant
    from baselines.laws.feedback_linearisation import epc, feedback_linearising
    from baselines.laws.gait import gait, gait_identifying

__all__ = ["adaptive", "adaptive_as_published", "compliant", "epc", "feedback_linearising", "gait", "gait_identifying"]

_LAZY = {
    "adaptive": ".laws.adaptive",
    "adaptive_as_published": ".laws.adaptive",
    "compliant": ".laws.adaptive",
    "epc": ".laws.feedback_linearisation",
    "feedback_linearising": ".laws.feedback_linearisation",
    "gait": ".laws.gait",
    "gait_identifying": ".laws.gait",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LAZY[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
