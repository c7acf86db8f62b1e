"""Trainings on disks that are full or read-only."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from agents.training import checkpoint
from tests.faults.bench import Bench, Outcome
from tests.faults.processes import Child
from tests.faults.trainings import KILL, steps_of


def begun(bench: Bench) -> Path:
    """A run that was killed after its first checkpoint."""
    run = bench.new("begun")
    child = bench.train("ppo", run)
    child.wait(lambda: steps_of(run) > 0)
    child.send(KILL)
    child.end()
    return run


def one_line(child: Child, name: Path, outcome: Outcome) -> None:
    """Expects that a training ended with one line that names a file or folder below `name`."""
    status, printed = child.end(), child.printed()
    error = printed.splitlines()[-1] if printed else ""
    right = error.startswith("train.py: error: ") and str(name) in error and "Traceback" not in printed
    outcome.expect(status == 2 and right, f"exit status {status}: {printed}")
    outcome.tried += 1


def small_files(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Trains where no file may grow beyond a limit, which different ones meet first."""
    run = begun(bench)
    for _ in range(tries):
        one_line(bench.train("ppo", run, limit=round(10.0 ** bench.rng.uniform(3.3, 4.5))), run, outcome)
        reason = checkpoint.damage(checkpoint.newest(run) or run)
        outcome.expect(reason is None, f"the last checkpoint is damaged: {reason}")
        bench.tick()
    bench.finish("ppo", run, outcome)


def full_disk(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Trains in a file system without room for all its checkpoints, then gives it some."""
    for _ in range(tries):
        with bench.mounted(bench.rng.randrange(100, 400)) as disk:
            if disk is None:
                outcome.skipped = "not tried: only root may mount"
                return
            one_line(bench.train("ppo", disk / "run"), disk, outcome)
            subprocess.run(["mount", "-o", "remount,size=16m", str(disk)], check=True)
            bench.finish("ppo", disk / "run", outcome)
        bench.tick()


def read_only(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Begins a run, and goes on with one, where nothing may be written."""
    run, parent = begun(bench), bench.new("parent")
    parent.mkdir()
    for _ in range(tries):
        for folder, child in ((run, run), (parent, parent / "run")):
            with bench.read_only(folder):
                if os.access(folder, os.W_OK):
                    outcome.skipped = "not tried: root may write everywhere, and mount nothing here"
                    return
                one_line(bench.train("ppo", child), folder, outcome)
        bench.tick()
    bench.finish("ppo", run, outcome)
