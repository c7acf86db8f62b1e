"""Checks of arguments, whose errors name the argument, its value and what would be accepted."""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

# Subclasses of Python's and numpy's integers that are none.
NO_NUMBERS = (bool, np.timedelta64)
# Characters of a value in a message.
LONGEST = 1000


def written(value: Any) -> str:
    """A value as a message shows it, without the middle of a long one."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        return f"{type(value).__name__} of more digits than can be shown"
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2]} .. {text[-LONGEST // 2 :]}"


def first_cause(error: Exception) -> str:
    """An error in one line; of one of numba's, the first cause and the line of source that it is about."""
    text = re.sub(r"\x1b\[\d*m", "", str(error))
    lines = [line.strip() for line in text.splitlines() if line.strip() and "pipeline (step:" not in line]
    cause = " ".join(lines[: 2 if lines and lines[0].endswith(":") else 1])
    place = re.search(r'File "(.*)", line (\d+)', text) or re.search(r" at (\S+) \((\d+)\)", text)
    return cause + (f" ({Path(place[1]).name}, line {place[2]})" if place else "")


def nearest(given: str, names: Iterable[str]) -> str:
    """The end of a message that refuses a name: the most similar one that there is, or nothing where none is."""
    return "".join(f"; did you mean {name!r}?" for name in difflib.get_close_matches(given, list(names), n=1))


def check_number(
    name: str, value: Any, accepted: str, low: float = -math.inf, high: float = math.inf, *, open_low: bool = False
) -> float:
    """Returns `value` as a float, or says which argument is wrong, what it is and what would be accepted.

    Args:
        name: the argument's name, for the message.
        value: what the caller gave.
        accepted: the accepted range in words, for the message.
        low: smallest accepted value.
        high: largest accepted value.
        open_low: whether `low` itself is refused.

    Raises:
        TypeError: if `value` is no real number.
        ValueError: if it is not finite or outside the range.
    """
    if isinstance(value, NO_NUMBERS) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"{name} must be {accepted}, got {written(value)} of type {type(value).__name__}")
    try:
        number = float(value)
    except OverflowError:  # an integer beyond the largest float
        number = math.inf
    if not math.isfinite(number) or number < low or number > high or (open_low and number == low):
        raise ValueError(f"{name} must be {accepted}, got {written(value)}")
    return number


def check_integer(name: str, value: Any, accepted: str, low: int, high: int) -> int:
    """Returns `value` as an int, or says which argument is wrong, what it is and what would be accepted.

    Raises:
        TypeError: if it is no integer.
        ValueError: if it is below `low` or above `high`.
    """
    if isinstance(value, NO_NUMBERS) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be {accepted}, got {written(value)}")
    if not low <= value <= high:
        raise ValueError(f"{name} must be {accepted}, got {written(value)}")
    return int(value)


def check_count(name: str, value: Any, most: int = sys.maxsize) -> int:
    """`check_integer` for a number of things, from 1 to `most`."""
    accepted = f"an integer from 1 to {most}" if most < sys.maxsize else "an integer >= 1"
    return check_integer(name, value, accepted, 1, most)


def check_name(argument: str, name: Any, kind: type, known: Iterable[str]) -> str:
    """Returns one of the known names, or says what argument is wrong, which an instance of `kind` could be as well."""
    if not isinstance(name, str) or name not in known:
        error = ValueError if isinstance(name, str) else TypeError
        raise error(f"{argument} must be a {kind.__name__} or one of {sorted(known)}, got {written(name)}")
    return name
