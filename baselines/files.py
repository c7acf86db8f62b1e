"""Files that are written whole or not at all, and JSON that any reader accepts."""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any


def write_atomically(path: Path, text: str) -> None:
    """Writes a text file by way of a temporary one beside it, so that nobody ever reads half of it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


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
    """Indented JSON with None for numbers that are not finite."""
    return json.dumps(without_nonfinite(value), indent=1, allow_nan=False) + "\n"


def canonical_hash(value: Any) -> str:
    """The sha256 of the value as JSON with sorted keys and no white space: layout and key order do not matter."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """The sha256 of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
