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
def naming(path: Path) -> Iterator[None]:
    """Gives an error of the system the name of a file or folder where it has none, as on a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the path of a temporary file next to `path`, of the same type, which takes its place at the end.

    Nobody ever reads half of the file, and where the block fails, or the power does, what stood there stays.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        with naming(path):
            yield temporary
            synchronise(temporary)
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Writes a file, text as UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def synchronise(path: Path) -> None:
    """Waits until a file's content, or a folder's list of names, is on the disk and not only on its way there."""
    folder = path.is_dir()
    # Windows opens no folders, and puts their names on the disk by itself.
    if folder and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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
