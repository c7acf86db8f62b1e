"""Files that are written whole or not at all, and JSON that any reader accepts."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the path of a temporary file beside `path`, of the same type, which takes its place at the end.

    Nobody ever reads half of the file, and where the block fails what stood there stays.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def without_nonfinite(value: Any) -> Any:
    """The same nested lists and dicts with None for NaN and infinity, which JSON does not know."""
    if isinstance(value, dict):
        return {key: without_nonfinite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nonfinite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(value: Any) -> str:
    """Indented JSON with None for numbers that are not finite.

    >>> print(to_json({"speed": 1.5, "cost": float("inf")}), end="")
    {
     "speed": 1.5,
     "cost": null
    }
    """
    return json.dumps(without_nonfinite(value), indent=1, allow_nan=False) + "\n"


def canonical_hash(value: Any) -> str:
    """The sha256 of the value as JSON with sorted keys and no white space: layout and key order do not matter.

    >>> canonical_hash({"M": 0.5, "mu": 0.01}) == canonical_hash({"mu": 0.01, "M": 0.5})
    True
    """
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """The sha256 of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
