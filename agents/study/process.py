"""A run in a process of its own: one that dies takes no other with it, and is begun again from its checkpoint."""

from __future__ import annotations

import pickle
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from agents.study.jobs import Job, Outcome
from agents.training.presets import Config
from agents.training.stopping import INTERRUPTED

ROOT = Path(__file__).resolve().parents[2]
# How often the process of a run may die before the run has failed.
ATTEMPTS = 3
# Between two looks at a process, s.
POLL = 0.2


class Training:
    """The process that trains a run, or goes on with it.

    Args:
        run: the run's folder; what the process prints goes into a file beside it.
        config: its configuration.
    """

    def __init__(self, run: Path, config: Config) -> None:
        run = run.resolve()
        run.parent.mkdir(parents=True, exist_ok=True)
        self.log = run.with_name(f"{run.name}.log")
        command = [sys.executable, "-m", "agents.study.worker", str(run)]
        with self.log.open("wb") as log:
            # A session of its own: Ctrl-C is for whoever waits.
            self._process = subprocess.Popen(
                command, cwd=ROOT, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True
            )
        assert self._process.stdin is not None
        self._stdin = self._process.stdin
        with suppress(BrokenPipeError):
            self._stdin.write(pickle.dumps(config))
            self._stdin.flush()

    def status(self) -> int | None:
        """The exit status, negative for a signal; None while it trains."""
        return self._process.poll()

    def stop(self) -> None:
        """Tells it to write a checkpoint and end; it does so after the update that is under way."""
        with suppress(BrokenPipeError):
            self._stdin.close()

    def wait(self) -> int:
        """The exit status, once it has one."""
        return self._process.wait()

    def last_line(self) -> str:
        """The last that it printed."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")


def train_run(job: Job, stop: Path) -> Outcome:
    """Trains a run, or goes on with it, until its end or until the file `stop` is there."""
    status = None
    for _ in range(ATTEMPTS):
        if stop.exists():
            return Outcome(job, "stopped")
        training = Training(job.run, job.config)
        try:
            while (status := training.status()) is None:
                if stop.exists():
                    training.stop()
                time.sleep(POLL)
        finally:
            training.stop()
        if status == 0:
            return Outcome(job, "finished")
        if status == INTERRUPTED:
            return Outcome(job, "stopped")
        if status > 0:
            return Outcome(job, "failed", f"{training.last_line()} (see {training.log})")
    return Outcome(job, "failed", f"its process died {ATTEMPTS} times, at last with status {status}")
