"""Atomic writing of files, reading of arrays, and JSON that any reader accepts."""

import hashlib
import io
import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


@contextmanager
def add_name_to_errors(path: Path) -> Iterator[None]:
    """Adds the name of a file or folder to a system error without one, as on a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields the path of a temporary file, which replaces `path` at the end.

    It lies next to `path` and has the same suffix.
    Readers never see a partial file. After an error in the block, or a power failure, the previous
    file remains.
    """
    # Random, since processes on two machines, and threads, may write the same file.
    token = secrets.token_hex(8)
    # Shortened, since names have at most 255 bytes.
    temporary = path.with_name(f".{path.stem[:20]}.{token}.tmp{path.suffix[:20]}")
    try:
        with add_name_to_errors(path):
            yield temporary
            synchronise(temporary)
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Writes a file atomically, text as UTF-8."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def synchronise(path: Path) -> None:
    """Waits until a file's content, or a folder's list of names, is on the disk."""
    # Windows cannot open folders, and writes their names to the disk by itself.
    if os.name == "nt" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Reads the arrays of an npz file by name.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is malformed.
    """
    content = path.read_bytes()
    try:
        # From memory, since numpy does not close an invalid file.
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return dict(arrays)
    # A malformed file makes numpy raise errors of any kind.
    except Exception as error:
        found = f"{type(error).__name__}: {error}"
        raise ValueError(f"{path} must be a file of numpy.savez, got {found}") from error


def to_json(value: Any) -> str:
    """Indented JSON with None for numbers that are not finite.

    >>> print(to_json({"speed": 1.5, "cost": float("inf")}), end="")
    {
     "speed": 1.5,
     "cost": null
    }
    """
    finite = json.loads(json.dumps(value), parse_constant=lambda name: None)
    return json.dumps(finite, indent=1) + "\n"


def canonical_hash(value: Any) -> str:
    """The sha256 of the value as JSON with sorted keys and no white space.

    Layout and the order of keys do not matter.

    >>> canonical_hash({"M": 0.5, "mu": 0.01}) == canonical_hash({"mu": 0.01, "M": 0.5})
    True
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
