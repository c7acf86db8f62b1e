"""One process per run."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from agents.training.errors import RunError

LOCK = "lock"
# Windows locks bytes, which nobody else can read then: one behind everything that is written.
FAR = 1 << 20


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Holds a run's folder for this process. The system lets go of it when the process ends, however it ends.

    Args:
        run: a folder that exists. Its file `lock` holds the id of the process that trains, and stays.

    Raises:
        RunError: if another process holds it.
        OSError: if the folder cannot be written to.
    """
    with (run / LOCK).open("a+", encoding="utf-8") as file:
        try:
            _lock(file)
        except BlockingIOError:
            file.seek(0)
            owner = file.read().strip() or "unknown"
            raise RunError(f"{run} is being trained already, by process {owner}") from None
        except OSError as error:
            print(
                f"{run}: this file system has no locks ({error.strerror}); see that no second process trains it",
                file=sys.stderr,
            )
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


if sys.platform == "win32":
    import msvcrt

    def _lock(file: TextIO) -> None:
        """Locks the file or raises BlockingIOError."""
        file.seek(FAR)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None

else:
    import fcntl

    def _lock(file: TextIO) -> None:
        """Locks the file or raises BlockingIOError."""
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
