"""What Ctrl-C and SIGTERM do: at once where nothing is lost by it, after the running update where something would be.

Imports nothing that takes time, so that train.py can be quiet from its first line on.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# What a shell reports after Ctrl-C.
INTERRUPTED = 130
STDERR = 2


def _say(text: str) -> None:
    """Writes a line to stderr from within a signal's handler, where print may already be under way."""
    with contextlib.suppress(OSError):
        os.write(STDERR, f"\n{text}\n".encode())


class Leaving:
    """Ends the process quietly.

    An exception out of the handler would meet imports, the compiler and destructors, some of which print a traceback or
    swallow it. What lies on disk is whole at any moment, so the process may simply end.

    Attributes:
        message: what it says last.
    """

    def __init__(self) -> None:
        self.message = "Stopped."

    def install(self) -> None:
        """Takes the signals over, for good."""
        for number in SIGNALS:
            signal.signal(number, self._leave)

    def _leave(self, number: int, frame: FrameType | None) -> None:
        # Whoever was writing when the signal came holds the buffer.
        with contextlib.suppress(OSError, RuntimeError):
            sys.stdout.flush()
        _say(self.message)
        os._exit(INTERRUPTED)


class Stop:
    """While its block runs, the first signal asks for an end; the second does what signals did before.

    Outside the main thread, which alone may handle signals, it does nothing.

    Attributes:
        requested: whether the signal has come.
    """

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Stop:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._request) for number in SIGNALS}
        return self

    def __exit__(self, *exception: object) -> None:
        self._give_back()

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        self._give_back()
        _say("Stopping after this update; once more stops at once.")

    def _give_back(self) -> None:
        while self._before:
            number, handler = self._before.popitem()
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
