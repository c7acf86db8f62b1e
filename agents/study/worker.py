"""Trains one run in a process of its own, for `agents.study.process`, which writes its configuration to stdin.

When stdin closes, because the run is to stop or because whoever waits for it is gone, it ends as after SIGTERM: saved.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
from pathlib import Path

from agents.study.jobs import note_end
from agents.training.errors import RunError
from agents.training.lock import locked
from agents.training.stopping import INTERRUPTED, Leaving

# How long a run may still be held by the process of an attempt that was killed, s.
PATIENCE = 120.0


def end_with_stdin() -> None:
    """Waits until stdin closes."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def wait_for(run: Path) -> None:
    """Waits until no other process trains a run.

    Raises:
        RunError: if one does for too long.
    """
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            with locked(run):
                return
        except RunError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.5)


def main() -> int:
    """The process; its argument is the run's folder."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print("agents.study.worker: started by python -m agents.study, for each of its runs", file=sys.stderr)
        return 2
    Leaving().install()
    run = Path(sys.argv[1])
    config = pickle.load(sys.stdin.buffer)
    threading.Thread(target=end_with_stdin, daemon=True).start()
    # Takes seconds to import, in which it can be told to stop.
    from agents.training.loop import begin, train

    try:
        if run.exists():
            wait_for(run)
        else:
            begin(run, config)
        if not train(run, config):
            return INTERRUPTED
        note_end(run)
    except (OSError, TypeError, ValueError) as error:
        print(f"\n{error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
