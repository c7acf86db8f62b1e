"""Handlers of Ctrl-C and SIGTERM: exit at once, or stop after the current update.

A process exits at once if no progress is lost. This module imports only the standard library, so
that train.py can handle signals before its slow imports.
"""

import contextlib
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# The exit status that a shell reports after Ctrl-C.
INTERRUPTED = 130
STDERR = 2


def _print_to_stderr(text: str) -> None:
    """Writes a line to stderr from a signal handler, which may have interrupted a `print`."""
    with contextlib.suppress(OSError):
        os.write(STDERR, f"\n{text}\n".encode())


class QuietExit:
    """A signal handler that ends the process without a traceback, and prints `message` to stderr.

    An exception from the handler could be raised in imports or destructors, some of which print a
    traceback or swallow it. Files are written atomically, so the process may end at any moment.
    """

    message = "Stopped."

    def install(self) -> None:
        """Installs the handler."""
        for number in SIGNALS:
            signal.signal(number, self._exit)

    def _exit(self, number: int, frame: FrameType | None) -> None:
        # Fails if the signal interrupted a print, which still uses the buffer.
        with contextlib.suppress(OSError, RuntimeError):
            sys.stdout.flush()
        _print_to_stderr(self.message)
        os._exit(INTERRUPTED)


class Stop:
    """A context in which the first signal sets `requested`.

    A second signal has its previous effect. The first signal also sets `requested` of an outer
    context. Outside the main thread, which alone may handle signals, a context has no effect.
    """

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Stop":
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._request) for number in SIGNALS}
        return self

    def __exit__(self, *exception: object) -> None:
        self._restore()

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        outer = getattr(self._before[signal.Signals(number)], "__self__", None)
        self._restore()
        if isinstance(outer, Stop):
            return outer._request(number, frame)
        _print_to_stderr("Stopping after this update; once more stops at once.")

    def _restore(self) -> None:
        while self._before:
            number, handler = self._before.popitem()
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
