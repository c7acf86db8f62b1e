"""Marks plain functions that compiled code may call; numba, which takes most of a second to import, hears of it later.

So what is needed of the plant and the task without a simulation, as by a command that shows its help, comes at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_marked: list[Any] = []
_told: list[Callable[[Any], Any]] = []


def inlined(function: Any) -> Any:
    """Marks a function whose calls compiled code replaces by its body: else no loop over environments is vectorised."""
    _marked.append(function)
    for tell in _told:
        tell(function)
    return function


def on_marking(tell: Callable[[Any], Any]) -> None:
    """Has every marked function told of, those that are marked already and those to come."""
    _told.append(tell)
    for function in _marked:
        tell(function)
