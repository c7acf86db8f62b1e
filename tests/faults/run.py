"""The faults, and the order in which they are injected."""

from __future__ import annotations

import itertools
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGTERM, Signals
from typing import TYPE_CHECKING

from agents.training import checkpoint
from agents.training.signals import INTERRUPTED
from tests.agents.training.small import differences, log
from tests.faults.processes import Child, fork, rollout, train

if TYPE_CHECKING:
    from tests.faults.__main__ import Args

# Trainings of seconds with many checkpoints. An update is 128 steps (PPO) or 8 (SAC).
SHARED = ["--task", "direct", "--num-envs", "8", "--hidden", "8", "--evaluation-episodes", "2", "--no-comparison"]
TINY = {
    "ppo": [*SHARED, "--algo", "ppo", "--n-steps", "16", "--n-epochs", "1", "--batch-size", "128"],
    "sac": [*SHARED, "--algo", "sac", "--gradient-steps", "1", "--batch-size", "32", "--learning-starts", "100"],
}
# Steps between checkpoints.
INTERVAL = {"ppo": 1024, "sac": 512}
# Moments of a kill or a stop: name, when, the signals (one of them, or both if they are equal), and their share.
KILLS = (
    ("kill -9 after a checkpoint", "training", (SIGKILL,), 0.60),
    ("kill -9 while a checkpoint is written", "writing", (SIGKILL,), 0.25),
    ("kill -9 at the start", "starting", (SIGKILL,), 0.15),
)
STOPS = (
    ("SIGTERM or Ctrl-C while training", "training", (SIGTERM, SIGINT), 0.40),
    ("SIGTERM or Ctrl-C while a checkpoint is written", "writing", (SIGTERM, SIGINT), 0.20),
    ("Ctrl-C twice", "training", (SIGINT, SIGINT), 0.15),
    ("SIGTERM or Ctrl-C while importing", "importing", (SIGTERM, SIGINT), 0.15),
    ("SIGTERM or Ctrl-C while compiling", "compiling", (SIGTERM, SIGINT), 0.10),
)


class Faults:
    """Injects faults and collects the results.

    Args:
        folder: of all files.
        intervals: checkpoints of a training.
        seed: of the moments.

    Attributes:
        tried: times that each fault was injected, by its name.
        broken: messages about what went wrong.
        lost: the most agent steps that had to be trained again.
    """

    def __init__(self, folder: Path, intervals: int, seed: int) -> None:
        self.folder, self.intervals, self.rng = folder, intervals, random.Random(seed)
        self.tried: dict[str, int] = {}
        self.broken: list[str] = []
        self.lost = 0
        self._names = itertools.count(1)
        self._references: dict[str, Path] = {}
        self._compiled: tuple[Path, str] | None = None

    def expect(self, name: str, condition: bool, message: str) -> None:
        """Notes what does not hold."""
        if not condition:
            self.broken.append(f"{name}: {message}")

    def new(self, name: str) -> Path:
        """A path that does not exist."""
        return self.folder / f"{name}-{next(self._names)}"

    # --- trainings ---------------------------------------------------------------------------------------------------

    def arguments(self, algo: str, run: Path) -> list[str]:
        """The command line that starts or resumes a run."""
        if (run / "config.json").is_file():
            return ["--resume", str(run), "--no-comparison"]
        length = ["--total-steps", str(self.intervals * INTERVAL[algo]), "--evaluate-every", str(INTERVAL[algo])]
        return [*TINY[algo], *length, "--run", str(run)]

    def train(self, algo: str, run: Path, *, cache: str = "", limit: int = 0) -> Child:
        """Starts or resumes a run in a process."""
        return Child(self.new("log"), train, self.arguments(algo, run), cache, limit)

    def finish(self, name: str, algo: str, run: Path) -> None:
        """Resumes a run to its end, and compares it with one without faults."""
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

    def stop(self, algo: str, tries: list[tuple[str, str, tuple[Signals, ...]]]) -> Iterator[str]:
        """Sends signals to trainings at random moments."""
        run, name = self.new(algo), ""
        for name, when, signals in tries:
            if steps_of(run) >= (self.intervals - 3) * INTERVAL[algo]:
                self.finish(name, algo, run)
                run = self.new(algo)
            if when == "importing":
                child = Child(self.new("log"), None, sys.executable, "train.py", *self.arguments(algo, run))
            else:
                child = self.train(algo, run, cache=str(self.new("cache")) if when == "compiling" else "")
            self.wait(child, run, when)
            for number in signals if len(set(signals)) == 1 else [self.rng.choice(signals)]:
                child.send(number)
                time.sleep(0.05)
            status, printed = child.end(), child.printed()
            # 0: it was complete before.
            expected = (0, -SIGKILL) if SIGKILL in signals else (0, INTERRUPTED)
            right = status in expected and "Traceback" not in printed
            self.expect(name, right, f"exit status {status}: {printed}")
            for path in run.glob("checkpoint-*"):
                self.expect(name, checkpoint.is_whole(path), f"{path.name} is damaged")
            lost = max(0, max(log(run), default=0) - steps_of(run))
            self.expect(name, lost <= INTERVAL[algo], f"{lost} steps are lost")
            self.lost = max(self.lost, lost)
            yield name
        if tries:
            self.finish(name, algo, run)

    def wait(self, child: Child, run: Path, when: str) -> None:
        """Waits for a moment, and a random time after it."""
        first, now = steps_of(run), time.time()
        conditions: dict[str, tuple[Callable[[], bool], float]] = {
            "training": (lambda: steps_of(run) > first, 0.5),
            "writing": (lambda: written_since(run, now), 0.02),
            "starting": (child.handles_signals, 1.5),
            "importing": (child.handles_signals, 3.0),
            "compiling": (lambda: "compiling" in child.printed(), 4.0),
        }
        condition, longest = conditions[when]
        child.wait(condition)
        child.wait(seconds=self.rng.uniform(0.0, longest))

    # --- disks -------------------------------------------------------------------------------------------------------

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

    def small_files(self, name: str, tries: int) -> Iterator[str]:
        """Trains where no file may grow beyond a random limit."""
        run = self.killed()
        for _ in range(tries):
            self.expect_one_line(name, self.train("ppo", run, limit=round(10.0 ** self.rng.uniform(3.3, 4.5))), run)
            latest = checkpoint.newest(run)
            self.expect(name, latest is not None and checkpoint.is_whole(latest), "the last checkpoint is damaged")
            yield name
        self.finish(name, "ppo", run)

    def full_disk(self, name: str, tries: int) -> Iterator[str]:
        """Trains in a file system that is too small for all checkpoints, then enlarges it; only root may mount one."""
        for _ in range(tries):
            disk = self.new("disk")
            disk.mkdir()
            size = f"size={self.rng.randrange(100, 400)}k"
            if subprocess.run(["mount", "-t", "tmpfs", "-o", size, "none", disk], capture_output=True).returncode:
                return
            try:
                self.expect_one_line(name, self.train("ppo", disk / "run"), disk)
                subprocess.run(["mount", "-o", "remount,size=16m", str(disk)], check=True)
                self.finish(name, "ppo", disk / "run")
            finally:
                subprocess.run(["umount", "-l", str(disk)], check=True)
            yield name

    def read_only(self, name: str, tries: int) -> Iterator[str]:
        """Starts and resumes runs in folders that cannot be written to."""
        run, parent = self.killed(), self.new("parent")
        parent.mkdir()
        for _ in range(tries):
            for folder, child in ((run, run), (parent, parent / "run")):
                with read_only(folder):
                    if os.access(folder, os.W_OK):
                        return
                    self.expect_one_line(name, self.train("ppo", child), folder)
            yield name
        self.finish(name, "ppo", run)

    # --- compiled code -----------------------------------------------------------------------------------------------

    def compiled(self) -> tuple[Path, str]:
        """A copy of a cache of a batch, and the hash of the batch."""
        if self._compiled is None:
            cache = self.new("cache")
            child = Child(self.new("log"), rollout, str(cache))
            if child.end() != 0:
                raise RuntimeError(f"a batch without faults failed: {child.printed()}")
            self._compiled = cache, child.printed().splitlines()[-1]
        cache, expected = self._compiled
        return Path(shutil.copytree(cache, self.new("cache"))), expected

    def expect_bits(self, name: str, child: Child) -> None:
        """Expects that a process prints the hash of the batch."""
        status, printed = child.end(), child.printed()
        right = status == 0 and printed.splitlines()[-1:] == [self.compiled()[1]]
        self.expect(name, right, f"exit status {status}: {printed}")

    def compile_at_once(self, name: str, tries: int) -> Iterator[str]:
        """Compiles for one empty cache in many processes at once."""
        cache = str(self.new("cache"))
        for child in [Child(self.new("log"), rollout, cache) for _ in range(tries)]:
            self.expect_bits(name, child)
            yield name
        self.expect_bits(name, Child(self.new("log"), rollout, cache))

    def damaged_cache(self, name: str, tries: int, how: str) -> Iterator[str]:
        """Runs a batch with a cache that is truncated, changed by a bit, read-only, or deleted in use."""
        for _ in range(tries):
            cache, _ = self.compiled()
            for path in cache.rglob("*.nb?"):
                content = bytearray(path.read_bytes())
                if how == "truncated":
                    del content[self.rng.randrange(len(content)) :]
                elif how == "changed by a bit":
                    content[self.rng.randrange(len(content))] ^= 1 << self.rng.randrange(8)
                else:
                    content = bytearray(self.rng.randbytes(len(content)))
                path.write_bytes(content)
            if how == "read-only":
                with read_only(cache):
                    self.expect_bits(name, Child(self.new("log"), rollout, str(cache)))
            else:
                child = Child(self.new("log"), rollout, str(cache))
                if how == "deleted":
                    child.wait(seconds=self.rng.uniform(0.0, 5.0))
                    shutil.rmtree(cache, ignore_errors=True)
                self.expect_bits(name, child)
            yield name

    def forks(self, name: str, tries: int) -> Iterator[str]:
        """Forks processes whose threads have run."""
        for _ in range(tries):
            child = Child(self.new("log"), fork)
            status, printed = child.end(), child.printed().split()
            right = status == 0 and len(printed) == 2 and len(set(printed)) == 1
            self.expect(name, right, f"exit status {status}: {child.printed()}")
            yield name


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
    newest = checkpoint.newest(run)
    return int(newest.name.split("-")[1]) if newest is not None else 0


def plan(faults: Faults, args: Args) -> Iterator[Iterator[str]]:
    """The faults that are injected; each iterator yields a fault's name after every time."""
    few = args.short
    totals = (4, 5) if few else (args.kills, args.kills // 2)
    moments = [
        (name, when, signals)
        for fault, kinds, total in (("kill", KILLS, totals[0]), ("stop", STOPS, totals[1]))
        for name, when, signals, share in kinds
        for _ in range(max(1, round(total * share)) if fault in args.fault else 0)
    ]
    faults.rng.shuffle(moments)
    for i, algo in enumerate(TINY):
        yield faults.stop(algo, moments[i :: len(TINY)])
    cache = ("changed by a bit",) if few else ("changed by a bit", "truncated", "garbled", "read-only", "deleted")
    others: list[tuple[str, Callable[[], Iterator[str]]]] = [
        ("disk", partial(faults.small_files, "a file that may not grow", 2 if few else 10)),
        ("disk", partial(faults.full_disk, "a full file system", 1 if few else 5)),
        ("readonly", partial(faults.read_only, "a folder that is read-only", 1 if few else 3)),
        ("processes", partial(faults.compile_at_once, "processes that compile at once", 2 if few else 8)),
        *(("cache", partial(faults.damaged_cache, f"a cache that is {how}", 1 if few else 3, how)) for how in cache),
        ("fork", partial(faults.forks, "fork after use", 2 if few else 10)),
    ]
    for fault, start in others:
        if fault in args.fault:
            yield start()
