"""Child processes that faults are injected into."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np
from tqdm import tqdm

from capsule_gym import CapsuleVectorEnv

ROOT = Path(__file__).resolve().parents[2]
HANG_SECONDS = 240.0

# Modules are imported once, by a process that is forked for each child.
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["agents.training.loop", "agents.report.comparison", "train", "tests.faults.processes"])


class Child:
    """A process that calls a function, or runs a command; its output goes to a file.

    Args:
        log: that file.
        function: the function; None for a command.
        arguments: the arguments of the function, or the words of the command.
    """

    def __init__(self, log: Path, function: Callable[..., None] | None, *arguments: Any) -> None:
        self.log = log
        log.write_text("")
        self._process: Any = None
        self._command: Any = None
        if function is None:
            with log.open("a") as file:
                self._command = subprocess.Popen(arguments, cwd=ROOT, stdout=file, stderr=file, start_new_session=True)
        else:
            self._process = CONTEXT.Process(target=_call, args=(str(log), function, arguments))
            self._process.start()
        self.pid: int = (self._process or self._command).pid

    def status(self) -> int | None:
        """The exit status, negative for a signal; None while it runs."""
        status: int | None = self._process.exitcode if self._process else self._command.poll()
        return status

    def send(self, number: signal.Signals) -> None:
        """Sends a signal, if the process still runs."""
        if self.status() is None:
            os.kill(self.pid, number)

    def wait(self, condition: Callable[[], bool] = lambda: False, seconds: float = HANG_SECONDS) -> bool:
        """Waits until the process has ended or the condition holds; returns whether that was in time."""
        deadline = time.monotonic() + seconds
        while self.status() is None and not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.001)
        return True

    def end(self) -> int | None:
        """Waits for the end and returns the exit status; kills a process that hangs and returns None."""
        if self.wait():
            return self.status()
        self.send(signal.SIGKILL)
        self.wait()
        return None

    def printed(self) -> str:
        """The end of its output."""
        return self.log.read_text(errors="replace")[-2000:]

    def handles_signals(self) -> bool:
        """Whether it has run the first lines of train.py."""
        try:
            status = Path(f"/proc/{self.pid}/status").read_text()
        except OSError:
            return False
        caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
        return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def _call(log: str, function: Callable[..., None], arguments: Sequence[Any]) -> None:
    """In the child: calls the function, with its output in a file."""
    # Ctrl-C in a terminal is for the parent.
    os.setsid()
    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    # tqdm's own lock belongs to the system, and outlives a process that is killed.
    tqdm.set_lock(threading.RLock())
    function(*arguments)
    sys.stdout.flush()


def train(arguments: Sequence[str], cache: str, limit: int) -> None:
    """In the child: train.py; `cache` is a folder of compiled code or "", `limit` the largest size of a file or 0."""
    import train as command

    command.QUIET_EXIT.install()
    if cache:
        numba.config.CACHE_DIR = cache
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    sys.exit(command.main(arguments))


def digest(env: CapsuleVectorEnv) -> str:
    """A hash of a hundred steps of a batch."""
    rng = np.random.default_rng(0)
    found = hashlib.sha256(env.reset(seed=1)[0].tobytes())
    for _ in range(100):
        observations, rewards, *_ = env.step(rng.uniform(-1.0, 1.0, (env.num_envs, 1)).astype(np.float32))
        found.update(observations.tobytes() + rewards.tobytes())
    return found.hexdigest()


def rollout(cache: str) -> None:
    """In the child: prints the hash of a batch, with a folder of compiled code."""
    numba.config.CACHE_DIR = cache
    print(digest(CapsuleVectorEnv(70)))


def fork() -> None:
    """In the child: forks after its threads have run; both processes then print the hash of their batch."""
    env = CapsuleVectorEnv(130, threads=2)
    digest(env)
    child = os.fork()
    print(digest(env), flush=True)
    env.close()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
