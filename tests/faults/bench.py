"""Where faults are tried, and what they come to."""

from __future__ import annotations

import itertools
import random
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from baselines.tables import text_table
from tests.agents.training.small import differences
from tests.faults.processes import Child, rollout, train

# Trainings of seconds with many checkpoints. An update is 128 steps (PPO) or 8 (SAC).
SHARED = ["--task", "direct", "--num-envs", "8", "--hidden", "8", "--evaluation-episodes", "2"]
TINY = {
    "ppo": [*SHARED, "--algo", "ppo", "--n-steps", "16", "--n-epochs", "1", "--batch-size", "128"],
    "sac": [*SHARED, "--algo", "sac", "--gradient-steps", "1", "--batch-size", "32", "--learning-starts", "100"],
}
# Steps between checkpoints.
INTERVAL = {"ppo": 1024, "sac": 512}


@dataclass
class Outcome:
    """What a fault has come to.

    Attributes:
        what: the fault, in words.
        tried: times that it was tried.
        lost: the most agent steps that had to be trained again; None where that is not asked.
        broken: what went wrong, in words.
        skipped: why it was not tried here.
    """

    what: str
    tried: int = 0
    lost: int | None = None
    broken: list[str] = field(default_factory=list)
    skipped: str = ""

    def expect(self, condition: bool, message: str) -> None:
        """Notes what does not hold."""
        if not condition:
            self.broken.append(f"{self.what}: {message}")


def table(outcomes: Sequence[Outcome]) -> str:
    """What the faults have come to."""
    lines = [["fault", "tried", "most steps lost", "broken"]]
    for outcome in outcomes:
        lost = "-" if outcome.lost is None else str(outcome.lost)
        broken = outcome.skipped or (str(len(outcome.broken)) if outcome.broken else "none")
        lines.append([outcome.what, str(outcome.tried), lost, broken])
    return text_table(lines, left=1)


class Bench:
    """Where the faults are tried.

    Args:
        folder: everything lies below it.
        intervals: checkpoints of a training.
        seed: of the moments.
        tick: is called after every trial, or with the number of several.
    """

    def __init__(self, folder: Path, intervals: int, seed: int, tick: Callable[..., object]) -> None:
        self.folder = folder
        self.intervals = intervals
        self.rng = random.Random(seed)
        self.tick = tick
        self._names = itertools.count(1)
        # Of what is made once, for all trials.
        self._lock = threading.Lock()
        self._references: dict[str, Path] = {}
        self._compiled: tuple[Path, str] | None = None

    def new(self, name: str) -> Path:
        """A path that nothing has been at."""
        return self.folder / f"{name}-{next(self._names)}"

    @contextmanager
    def mounted(self, size: int) -> Iterator[Path | None]:
        """A file system of so many kilobytes; None for who may not have one."""
        disk = self.new("disk")
        disk.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "none", str(disk)]
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            yield None
            return
        try:
            yield disk
        finally:
            subprocess.run(["umount", "-l", str(disk)], check=True)

    @contextmanager
    def read_only(self, folder: Path) -> Iterator[Path]:
        """The folder, which nothing can be written to."""
        folder.chmod(0o555)
        # Root may write where the mode says no, but not where the file system does.
        bound = subprocess.run(["mount", "--bind", "-o", "ro", folder, folder], capture_output=True, check=False)
        try:
            yield folder
        finally:
            if bound.returncode == 0:
                subprocess.run(["umount", "-l", str(folder)], check=True)
            folder.chmod(0o755)

    def compiled(self) -> tuple[Path, str]:
        """A copy of a cache that a batch was compiled for, and the hash that the batch has."""
        with self._lock:
            if self._compiled is None:
                cache = self.new("cache")
                child = Child(self.new("log"), rollout, str(cache))
                if child.end() != 0:
                    raise RuntimeError(f"a batch failed that nobody disturbed: {child.printed()}")
                self._compiled = cache, child.printed().splitlines()[-1]
        cache, expected = self._compiled
        return Path(shutil.copytree(cache, self.new("cache"))), expected

    def arguments(self, algo: str, run: Path) -> list[str]:
        """The command line that begins a run, or goes on with it."""
        if (run / "config.json").is_file():
            return ["--resume", str(run), "--no-comparison"]
        interval = INTERVAL[algo]
        length = ["--total-steps", str(self.intervals * interval), "--evaluate-every", str(interval)]
        return [*TINY[algo], *length, "--run", str(run), "--no-comparison"]

    def train(self, algo: str, run: Path, *, cache: str = "", limit: int = 0) -> Child:
        """Begins a run, or goes on with it, in a process; the options are those of `processes.train`."""
        return Child(self.new("log"), train, self.arguments(algo, run), cache, limit)

    def finish(self, algo: str, run: Path, outcome: Outcome) -> None:
        """Goes on with a run to its end, and compares it with one that nobody disturbed."""
        child = self.train(algo, run)
        status = child.end()
        outcome.expect(status == 0, f"{run.name} does not go on (exit status {status}): {child.printed()}")
        if status == 0:
            found = differences(run, self._reference(algo))
            outcome.expect(not found, f"{run.name} differs in {', '.join(found)}")
        shutil.rmtree(run, ignore_errors=True)

    def _reference(self, algo: str) -> Path:
        """A run that nobody disturbed."""
        with self._lock:
            if algo not in self._references:
                run = self.new(f"whole-{algo}")
                child = self.train(algo, run)
                if child.end() != 0:
                    raise RuntimeError(f"a training failed that nobody disturbed: {child.printed()}")
                self._references[algo] = run
        return self._references[algo]
