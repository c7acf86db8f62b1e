"""The faults, and the processes that receive them."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import random
import resource
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGTERM, Signals
from typing import Any

from tqdm import tqdm

from agents.training import checkpoint
from agents.training.signals import INTERRUPTED
from tests.agents.training.small import differences, log

HANG_SECONDS = 240.0
# One process imports the modules, and is forked for each child.
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["agents.training.loop", "agents.report", "train", "tests.faults.run"])
# Trainings of seconds with many checkpoints. An update is 128 steps (PPO) or 8 (SAC).
SHARED = ["--task", "direct", "--num-envs", "8", "--hidden", "8", "--evaluation-episodes", "2", "--no-comparison"]
TINY = {
    "ppo": [*SHARED, "--algo", "ppo", "--n-steps", "16", "--n-epochs", "1", "--batch-size", "128"],
    "sac": [*SHARED, "--algo", "sac", "--gradient-steps", "1", "--batch-size", "32", "--learning-starts", "100"],
}
# Steps between checkpoints.
INTERVAL = {"ppo": 1024, "sac": 512}
# Kills and stops: name, moment, signals (one of them, or both if they are equal), and number of times.
MOMENTS = (
    ("kill -9 after a checkpoint", "training", (SIGKILL,), 60),
    ("kill -9 while a checkpoint is written", "writing", (SIGKILL,), 25),
    ("kill -9 at the start", "starting", (SIGKILL,), 15),
    ("SIGTERM or Ctrl-C while training", "training", (SIGTERM, SIGINT), 20),
    ("SIGTERM or Ctrl-C while a checkpoint is written", "writing", (SIGTERM, SIGINT), 10),
    ("Ctrl-C twice", "training", (SIGINT, SIGINT), 8),
    ("SIGTERM or Ctrl-C while importing", "importing", (SIGTERM, SIGINT), 8),
)


class Child:
    """A process that calls a function; its output goes to a file.

    Args:
        output: the file.
        function: the function.
        arguments: of the function.
    """

    def __init__(self, output: Path, function: Callable[..., None], *arguments: Any) -> None:
        self.output = output
        output.write_text("")
        self.process = CONTEXT.Process(target=_call, args=(str(output), function, arguments))
        self.process.start()

    def send(self, number: Signals) -> None:
        """Sends a signal, if the process still runs."""
        if self.process.exitcode is None:
            os.kill(self.process.pid or 0, number)

    def wait(self, condition: Callable[[], bool] = lambda: False, seconds: float = HANG_SECONDS) -> None:
        """Waits until the process has ended, the condition holds or the time is over."""
        deadline = time.monotonic() + seconds
        while self.process.exitcode is None and not condition() and time.monotonic() < deadline:
            time.sleep(0.001)

    def end(self) -> int | None:
        """Waits for the end and returns the exit status; kills a process that hangs and returns None."""
        self.wait()
        status = self.process.exitcode
        self.send(SIGKILL)
        return status

    def printed(self) -> str:
        """The last part of the output."""
        return self.output.read_text(errors="replace")[-2000:]

    def handles_signals(self) -> bool:
        """Whether the process has run the first lines of train.py."""
        try:
            status = Path(f"/proc/{self.process.pid}/status").read_text()
        except OSError:
            return False
        caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
        return bool(int(caught.split()[1], 16) >> (SIGTERM - 1) & 1)


def _call(output: str, function: Callable[..., None], arguments: Sequence[Any]) -> None:
    """In the child: calls the function, with its output in a file."""
    # Ctrl-C in a terminal is meant for the parent.
    os.setsid()
    descriptor = os.open(output, os.O_WRONLY | os.O_APPEND)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    # tqdm's own lock belongs to the system, and outlives a process that is killed.
    tqdm.set_lock(threading.RLock())
    function(*arguments)
    sys.stdout.flush()


def train(arguments: Sequence[str], limit: int) -> None:
    """In the child: runs train.py; `limit` is the largest file size or 0."""
    import train as command

    command.QUIET_EXIT.install()
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    sys.exit(command.main(arguments))


def execute(arguments: Sequence[str]) -> None:
    """In the child: runs train.py in a new Python."""
    os.execv(sys.executable, [sys.executable, "train.py", *arguments])


class Faults:
    """Injects faults and collects the results.

    Args:
        folder: the folder of all files.
        short: whether to inject each fault only once or a few times.

    Attributes:
        broken: messages about what went wrong.
        lost: the most agent steps that had to be trained again.
    """

    def __init__(self, folder: Path, *, short: bool) -> None:
        self.folder, self.short, self.rng = folder, short, random.Random(0)
        self.intervals = 5 if short else 12
        self.broken: list[str] = []
        self.lost = 0
        self._names = itertools.count(1)
        self._references: dict[str, Path] = {}

    def inject(self) -> Iterator[str]:
        """Injects all faults; yields the fault's name after each injection."""
        moments = [
            (name, when, signals)
            for name, when, signals, times in MOMENTS
            for _ in range(1 + times // 50 if self.short else times)
        ]
        self.rng.shuffle(moments)
        for i, algo in enumerate(TINY):
            yield from self.stop(algo, moments[i :: len(TINY)])
        yield from self.small_files(2 if self.short else 10)
        yield from self.read_only(1 if self.short else 3)

    def expect(self, name: str, condition: bool, message: str) -> None:
        """Records a condition that does not hold."""
        if not condition:
            self.broken.append(f"{name}: {message}")

    def new(self, name: str) -> Path:
        """A path that does not exist."""
        return self.folder / f"{name}-{next(self._names)}"

    def arguments(self, algo: str, run: Path) -> list[str]:
        """The command line that starts or resumes a run."""
        if (run / "config.json").is_file():
            return ["--resume", str(run), "--no-comparison"]
        length = ["--total-steps", str(self.intervals * INTERVAL[algo]), "--evaluate-every", str(INTERVAL[algo])]
        return [*TINY[algo], *length, "--run", str(run)]

    def train(self, algo: str, run: Path, *, limit: int = 0) -> Child:
        """Starts or resumes a run in a process."""
        return Child(self.new("log"), train, self.arguments(algo, run), limit)

    def finish(self, name: str, algo: str, run: Path) -> None:
        """Resumes a run to its end, and compares it with a run without faults."""
        if algo not in self._references:
            reference = self.new(f"whole-{algo}")
            if (child := self.train(algo, reference)).end() != 0:
                raise RuntimeError(f"a training without faults failed: {child.printed()}")
            self._references[algo] = reference
        child = self.train(algo, run)
        status = child.end()
        self.expect(name, status == 0, f"{run.name} is not resumed (exit status {status}): {child.printed()}")
        if status == 0:
            found = differences(run, self._references[algo])
            self.expect(name, not found, f"{run.name} differs in {', '.join(found)}")
        shutil.rmtree(run, ignore_errors=True)

    def stop(self, algo: str, tries: Sequence[tuple[str, str, tuple[Signals, ...]]]) -> Iterator[str]:
        """Sends signals to trainings at random moments."""
        run, name = self.new(algo), ""
        for name, when, signals in tries:
            if steps_of(run) >= (self.intervals - 3) * INTERVAL[algo]:
                self.finish(name, algo, run)
                run = self.new(algo)
            if when == "importing":
                child = Child(self.new("log"), execute, self.arguments(algo, run))
            else:
                child = self.train(algo, run)
            self.wait(child, run, when)
            for number in signals if len(set(signals)) == 1 else [self.rng.choice(signals)]:
                child.send(number)
                time.sleep(0.05)
            status, printed = child.end(), child.printed()
            # 0: the run was already complete.
            expected = (0, -SIGKILL) if SIGKILL in signals else (0, INTERRUPTED)
            right = status in expected and "Traceback" not in printed
            self.expect(name, right, f"exit status {status}: {printed}")
            for path in run.glob("checkpoint-*"):
                self.expect(name, checkpoint.is_whole(path), f"{path.name} is damaged")
            lost = max(0, max(log(run), default=0) - steps_of(run))
            self.expect(name, lost <= INTERVAL[algo], f"{lost} steps are lost")
            self.lost = max(self.lost, lost)
            yield name
        self.finish(name, algo, run)

    def wait(self, child: Child, run: Path, when: str) -> None:
        """Waits for a moment, and a random time after it."""
        first, now = steps_of(run), time.time()
        conditions: dict[str, tuple[Callable[[], bool], float]] = {
            "training": (lambda: steps_of(run) > first, 0.5),
            "writing": (lambda: written_since(run, now), 0.02),
            "starting": (child.handles_signals, 1.5),
            "importing": (child.handles_signals, 3.0),
        }
        condition, longest = conditions[when]
        child.wait(condition)
        child.wait(seconds=self.rng.uniform(0.0, longest))

    def killed(self) -> Path:
        """A run that was killed after its first checkpoint."""
        run = self.new("killed")
        child = self.train("ppo", run)
        child.wait(lambda: steps_of(run) > 0)
        child.send(SIGKILL)
        child.end()
        return run

    def expect_one_line(self, name: str, child: Child, path: Path) -> None:
        """Expects that a training ended with one line that names a file or folder below `path`."""
        status, printed = child.end(), child.printed()
        error = printed.splitlines()[-1] if printed else ""
        right = error.startswith("train.py: error: ") and str(path) in error and "Traceback" not in printed
        self.expect(name, status == 2 and right, f"exit status {status}: {printed}")

    def small_files(self, tries: int) -> Iterator[str]:
        """Trains where no file may grow beyond a random limit, as on a full disk."""
        name, run = "a file that may not grow", self.killed()
        for _ in range(tries):
            self.expect_one_line(name, self.train("ppo", run, limit=round(10.0 ** self.rng.uniform(3.3, 4.5))), run)
            latest = max(run.glob("checkpoint-*"), default=None)
            self.expect(name, latest is not None and checkpoint.is_whole(latest), "the last checkpoint is damaged")
            yield name
        self.finish(name, "ppo", run)

    def read_only(self, tries: int) -> Iterator[str]:
        """Starts and resumes runs in folders that cannot be written to."""
        name, run, parent = "a folder that is read-only", self.killed(), self.new("parent")
        parent.mkdir()
        for _ in range(tries):
            for folder, child in ((run, run), (parent, parent / "run")):
                with read_only(folder):
                    if os.access(folder, os.W_OK):
                        return
                    self.expect_one_line(name, self.train("ppo", child), folder)
            yield name
        self.finish(name, "ppo", run)


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Makes a folder read-only while the block runs; also for root, if it may mount."""
    folder.chmod(0o555)
    bound = subprocess.run(["mount", "--bind", "-o", "ro", folder, folder], capture_output=True, check=False)
    try:
        yield
    finally:
        if bound.returncode == 0:
            subprocess.run(["umount", "-l", str(folder)], check=True)
        folder.chmod(0o755)


def written_since(run: Path, then: float) -> bool:
    """Whether a checkpoint is being written."""
    try:
        return any(path.stat().st_mtime > then for path in run.glob(".checkpoint-*"))
    except FileNotFoundError:
        return False


def steps_of(run: Path) -> int:
    """Agent steps of the newest checkpoint; 0 without one."""
    newest = max(run.glob("checkpoint-*"), default=None)
    return int(newest.name.split("-")[1]) if newest is not None else 0
