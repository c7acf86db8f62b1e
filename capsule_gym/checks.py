"""Checks of arguments, whose errors name the argument, its value and the accepted values."""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Kind = TypeVar("Kind", bound="DataclassInstance")

# Subclasses of Python's and numpy's integers that are not numbers.
NO_NUMBERS = (bool, np.timedelta64)
# Largest number of characters of a value in a message.
LONGEST = 1000


def short_repr(value: Any) -> str:
    """The text of a value in a message; a long text is shortened in the middle."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        return f"{type(value).__name__} of more digits than can be shown"
    return shortened(text)


def shortened(text: str) -> str:
    """The text, without its middle if it is long."""
    if len(text) <= LONGEST:
        return text
    half = LONGEST // 2
    return f"{text[:half]} .. {text[-half:]}"


def require(
    fits: bool, name: str, accepted: str, value: Any, kind: type[Exception] = ValueError
) -> None:
    """Raises an error that names the argument and its value, unless the value fits."""
    if not fits:
        raise kind(f"{name} must be {accepted}, got {short_repr(value)}")


@contextmanager
def prefix_errors(name: str) -> Iterator[None]:
    """Begins the message of a TypeError or ValueError with the argument that contains the value."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name}: {error}") from None


def first_cause(error: Exception) -> str:
    """The first cause in the message of an error, in one line.

    For an error of numba, its line of the source follows.
    """
    text = re.sub(r"\x1b\[\d*m", "", str(error))
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and "pipeline (step:" not in line]
    # A line that ends with a colon introduces the next one.
    cause = " ".join(lines[: 2 if lines and lines[0].endswith(":") else 1])
    place = re.search(r'File "(.*)", line (\d+)', text) or re.search(r" at (\S+) \((\d+)\)", text)
    if place is None:
        return cause
    file, line = place.groups()
    return f"{cause} ({Path(file).name}, line {line})"


def nearest(given: str, names: Iterable[str]) -> str:
    """The end of a message for an unknown name: the most similar known one, or an empty string."""

    def simplified(name: str) -> str:
        return name.lower().replace("_", "-")

    known = {simplified(name): name for name in names}
    similar = difflib.get_close_matches(simplified(given[:LONGEST]), known, n=1)
    return f"; did you mean {known[similar[0]]!r}?" if similar else ""


def as_floats(values: Any) -> np.ndarray:
    """A new array of the values, float64, with NaN where they are masked."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    return np.array(values, np.float64)


def check_number(
    name: str,
    value: Any,
    accepted: str,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    open_low: bool = False,
) -> float:
    """Returns `value` as a float, or raises an error that names the argument and its value.

    Args:
        name: the argument's name.
        value: value of the argument.
        accepted: the accepted range in words.
        low: smallest accepted value.
        high: largest accepted value.
        open_low: whether `low` itself is excluded.

    Raises:
        TypeError: if `value` is not a real number.
        ValueError: if it is not finite or outside the range.
    """
    without_axes = isinstance(value, np.ndarray) and value.ndim == 0
    scalar = value[()] if without_axes else value
    real = isinstance(scalar, (int, float, np.integer, np.floating))
    if not real or isinstance(scalar, NO_NUMBERS):
        got = f"{short_repr(value)} of type {type(value).__name__}"
        raise TypeError(f"{name} must be {accepted}, got {got}")
    try:
        number = float(scalar)
    except OverflowError:  # an integer beyond the largest float
        number = math.inf
    above = number > low if open_low else number >= low
    require(math.isfinite(number) and above and number <= high, name, accepted, value)
    return number


def check_integer(name: str, value: Any, accepted: str, low: int, high: int) -> int:
    """Returns `value` as an int, or raises an error that names the argument and its value."""
    integer = isinstance(value, (int, np.integer)) and not isinstance(value, NO_NUMBERS)
    require(integer, name, accepted, value, TypeError)
    require(low <= value <= high, name, accepted, value)
    return int(value)


def check_count(name: str, value: Any, most: int = sys.maxsize) -> int:
    """`check_integer` for a count from 1 to `most`."""
    accepted = f"an integer from 1 to {most}" if most < sys.maxsize else "an integer >= 1"
    return check_integer(name, value, accepted, 1, most)


def check_name(argument: str, name: Any, kind: type, known: Iterable[str]) -> str:
    """Returns a known name, or raises an error; the argument may also be an instance of `kind`."""
    accepted = f"a {kind.__name__} or one of {sorted(known)}"
    require(isinstance(name, str), argument, accepted, name, TypeError)
    require(name in known, argument, accepted, name)
    return str(name)


def check_choice(name: str, value: Any, choices: Sequence[str], accepted: str) -> str:
    """Returns one of the choices, or raises a ValueError."""
    # `in` raises an error for an array.
    require(isinstance(value, str) and value in choices, name, accepted, value)
    return str(value)


def check_flag(name: str, value: Any) -> bool:
    """Returns a bool, or raises a TypeError."""
    require(isinstance(value, (bool, np.bool_)), name, "True or False", value, TypeError)
    return bool(value)


def check_timed(
    name: str, value: Any, accepted: str, keys: tuple[str, ...]
) -> Iterator[tuple[str, float, Any]]:
    """Checks a list of dicts with these keys, in ascending order of their time "t" in s.

    Yields:
        The name of a dict in messages, its time, and the dict.
    """
    require(isinstance(value, (list, tuple)), name, accepted, value, TypeError)
    *others, final = map(repr, keys)
    required = f"a dict with the keys {', '.join(others)} and {final} and no others"
    last = -math.inf
    for n, entry in enumerate(value):
        where = f"{name}[{n}]"
        require(isinstance(entry, dict), where, required, entry, TypeError)
        require(set(entry) == set(keys), where, required, entry)
        t = check_number(f"{where}['t']", entry["t"], "a finite number >= 0 (s)", 0.0)
        if t <= last:
            times = f"the one before, {last:g} s, got {t:g} s"
            raise ValueError(f"{where}['t'] must be later than {times}")
        yield where, t, entry
        last = t


def check_pair(name: str, value: Any, accepted: str, **limits: Any) -> tuple[float, float]:
    """Validates a pair (low, high) of numbers; `limits` are those of `check_number`."""
    try:
        low, high = value
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be {accepted}, got {short_repr(value)}") from None
    low = check_number(f"{name}[0]", low, accepted, **limits)
    high = check_number(f"{name}[1]", high, accepted, **limits)
    require(low <= high, name, accepted, value)
    return low, high


def from_fields(kind: type[Kind], argument: str, values: dict[str, Any]) -> Kind:
    """The object with these fields, which JSON contains instead; raises the fields' errors."""
    names = [each.name for each in fields(kind)]
    for name in values:
        if name not in names:
            got = f"{short_repr(name)}{nearest(str(name), names)}"
            raise ValueError(f"{argument} must have fields out of {names}, got {got}")
    with prefix_errors(argument):
        return kind(**values)
