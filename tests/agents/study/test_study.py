"""Studies as their users meet them: runs that fail, die, are stopped, and are gone on with."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from agents.study.__main__ import main
from agents.study.jobs import FINISHED, Job
from agents.study.study import tell, train_all
from tests.agents.study.small import STEPS, job

ROOT = Path(__file__).resolve().parents[3]
needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")


def wait_for(condition: Callable[[], object], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def kill_once(run: Path, find: Callable[[int], int]) -> threading.Thread:
    """Kills a process once the run has a checkpoint; `find` is given the one that trains."""

    def kill() -> None:
        wait_for(lambda: list(run.glob("checkpoint-*[0-9]")))
        os.kill(find(int((run / "lock").read_text())), signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


def parent_of(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


def resumed_at(made: Job) -> list[int]:
    checkpoint = max(made.run.glob("checkpoint-*[0-9]"))
    return json.loads((checkpoint / "progress.json").read_text())["resumed_at"]


def test_a_run_that_fails_or_dies_takes_no_other_with_it(tmp_path, capsys):
    # The second dies in training, and goes on; the third cannot be begun.
    jobs = [job(tmp_path, 0), job(tmp_path, 1, total_steps=15 * STEPS), job(tmp_path, 2, gamma=2.0)]
    thread = kill_once(jobs[1].run, lambda process: process)
    outcomes = train_all(jobs, tmp_path, 2)
    thread.join()
    assert [outcome.state for outcome in outcomes] == ["finished", "finished", "failed"]
    assert [outcome.job for outcome in outcomes] == jobs
    assert "gamma must be a number in [0, 1], got 2.0" in outcomes[2].reason
    assert resumed_at(jobs[0]) == [] and len(resumed_at(jobs[1])) == 1
    assert json.loads((jobs[0].run / FINISHED).read_text())["steps"] == STEPS
    assert not list(tmp_path.glob(".stop-*"))
    tell(outcomes)
    out, err = capsys.readouterr()
    assert "tiny/seed-1" in out and "tiny/seed-2 failed: gamma" in err

    # What is finished is not begun again.
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    again = train_all(jobs[:2], tmp_path, 2)
    assert [outcome.state for outcome in again] == ["finished", "finished"]
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


@contextmanager
def endless(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A study that two runs of have begun; it ends with the block, whatever happens there."""
    command = [sys.executable, "-m", "tests.agents.study.small", "endless", "--seeds", "0-2", "--jobs", "2"]
    command += ["--runs", str(folder)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            begun = "endless/seed-*/checkpoint-*[0-9]"
            wait_for(lambda: len({path.parent for path in folder.glob(begun)}) == 2 or process.poll() is not None)
            assert process.poll() is None, process.communicate()
            yield process
        finally:
            process.kill()


def trains(run: Path) -> bool:
    """Whether the process that trains a run is there; one that has ended may not be buried yet."""
    stat = Path(f"/proc/{(run / 'lock').read_text().strip()}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


def newest(runs: list[Path]) -> list[str]:
    """The names of the newest checkpoints, which are in the order of their steps."""
    return [max(run.glob("checkpoint-*[0-9]")).name for run in runs]


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_ctrl_c_saves_all_runs_and_a_killed_study_leaves_none_running(tmp_path):
    with endless(tmp_path) as process:
        runs = sorted(path for path in tmp_path.glob("endless/seed-*") if path.is_dir())
        assert len(runs) == 2
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "The same command goes on." in out
    assert not any(trains(run) for run in runs)
    # The third was not begun any more.
    assert sorted(path for path in tmp_path.glob("endless/seed-*") if path.is_dir()) == runs
    stopped = newest(runs)

    with endless(tmp_path):
        wait_for(lambda: all(map(trains, runs)) and newest(runs) > stopped)
    wait_for(lambda: not any(trains(run) for run in runs))


@needs_ray
@pytest.mark.filterwarnings("ignore")
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_a_ray_worker_that_is_killed_costs_its_run_nothing_but_time(tmp_path):
    jobs = [job(tmp_path, seed, total_steps=15 * STEPS) for seed in range(2)]
    thread = kill_once(jobs[0].run, parent_of)
    outcomes = train_all(jobs, tmp_path, 2, "ray")
    thread.join()
    assert [outcome.state for outcome in outcomes] == ["finished", "finished"]
    assert len(resumed_at(jobs[0])) == 1 and resumed_at(jobs[1]) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "NAME"),
        (["fastest"], "got 'fastest'"),
        (["direct-ppo", "--seeds", "a"], "--seeds must be integers and ranges such as 0-9"),
        (["direct-ppo", "--jobs", "0"], "--jobs must be an integer >= 1, got 0"),
        (["direct-ppo", "--backend", "cloud"], "--backend"),
    ],
)
def test_bad_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
