"""The scripted baselines: the paper's trajectories, control laws and policies made of them.

The laws of `baselines.laws.LAWS` are the functions that the environment's argument `controller` takes, as in
`controller="baselines:adaptive"`. Each is imported when it is first used: numba takes most of a second to import.
"""

from importlib import import_module
from typing import Any

from baselines.laws import LAWS

__all__ = sorted(LAWS)


def __getattr__(name: str) -> Any:
    if name not in LAWS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"baselines.laws.{LAWS[name].module}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
