"""Resuming: a killed and resumed run ends like an undisturbed run; errors name damaged and broken
files."""

import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import train as command_line
from agents.training import callbacks, checkpoint, loop
from agents.training.algorithms import make_env
from agents.training.checkpoint import locked
from agents.training.config import RunError, read_config
from agents.training.loop import begin, train
from agents.training.signals import INTERRUPTED, Stop
from tests.agents.training.small import differences, finished, parameters, train_until
from tests.agents.training.small import small as make_config

OFF_POLICY = {"learning_starts": 150, "buffer_size": 600, "gradient_steps": 1, "total_steps": 800}
OWN = {
    "ppo": {
        "n_steps": 16,
        "n_epochs": 1,
        "total_steps": 800,
        "episode_seconds": 0.2,
        "randomization": "wide",
    },
    "sac": {**OFF_POLICY, "n_steps": 3, "action_noise": 0.2, "noise_time": 0.25},
    "td3": {**OFF_POLICY, "noise_time": 0.25},
}


def small(algo, **changes):
    return make_config(
        "residual",
        algo,
        **{"evaluation_episodes": 1, "evaluate_every": 200, **OWN[algo], **changes},
    )


def steps_of(run):
    return max(map(checkpoint.steps_of, run.glob("checkpoint-*")), default=0)


def scalars(run):
    events = EventAccumulator(str(run / "logs")).Reload()
    return {event.step: event.value for event in events.Scalars("evaluation/score")}


@pytest.fixture(scope="module", autouse=True)
def _short_runs_write_a_log():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(callbacks, "LOG_EVERY", 200)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An undisturbed run of each algorithm."""
    return {algo: finished(tmp_path_factory.mktemp("whole") / algo, small(algo)) for algo in OWN}


@pytest.mark.parametrize("algo", OWN)
def test_a_run_that_was_killed_and_stopped_ends_with_the_same_policy(
    tmp_path, monkeypatch, whole, algo
):
    run = tmp_path / "run"
    begin(run, small(algo))
    # The run is killed before the first checkpoint, and after it.
    train_until(run, 100, monkeypatch, killed=True)
    assert steps_of(run) == 0
    train_until(run, 390, monkeypatch, killed=True)
    assert 200 <= steps_of(run) < 390
    train_until(run, 410, monkeypatch, killed=False)
    assert 410 <= steps_of(run) < 600
    # Random numbers drawn in between do not affect the run.
    for draw in (random.random, np.random.random, lambda: torch.rand(1)):
        draw()
    assert (
        train(run) and differences(run, whole[algo]) == [] and scalars(run) == scalars(whole[algo])
    )
    assert len(list(run.glob("checkpoint-*"))) == 2 and all(
        map(checkpoint.is_whole, run.glob("checkpoint-*"))
    )


def test_all_random_streams_go_on(whole):
    found, drawn = sorted(whole["ppo"].glob("checkpoint-*"))[-1], []
    model, _, restore_streams = checkpoint.restore(found, PPO, make_env(small("ppo"), 0))
    model.set_logger(Logger(None, []))
    for _ in range(2):
        restore_streams()
        drawn.append(
            (
                random.random(),
                np.random.random(),
                torch.rand(1).item(),
                model.action_space.sample()[0],
            )
        )
    assert drawn[0] == drawn[1]


def test_evaluations_leave_the_training_alone(tmp_path, whole):
    run = finished(tmp_path / "run", small("ppo", evaluate_every=10_000))
    assert parameters(run / "model.zip") == parameters(whole["ppo"] / "model.zip")


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_a_run_goes_on_from_the_checkpoint_before_a_damaged_one(tmp_path, capsys, whole):
    run = shutil.copytree(whole["ppo"], tmp_path / "run")
    older, newer = sorted(run.glob("checkpoint-*"))
    flip(newer)
    # Removes a final file, and adds partial files of a process that was killed while it wrote.
    (run / "model.zip").unlink()
    left = [run / ".model.77.tmp.zip", run / "best" / ".policy.77.tmp.safetensors"]
    left += [run / f".{older.name[:20]}.77.tmp"]
    other, backup = (
        run / ".report.78.tmp.html",
        run / f"{older.name}.bak",
    )  # of a process that needs no lock
    for path in (*left, other, backup):
        path.write_bytes(b"half")
    assert (
        train(run)
        and f"{newer} is damaged" in capsys.readouterr().err
        and differences(run, whole["ppo"]) == []
    )
    assert sorted(run.glob("checkpoint-*")) == [older, backup, newer] and checkpoint.is_whole(newer)
    assert not any(path.exists() for path in left) and other.exists()


@pytest.mark.parametrize(
    "damage", [flip, lambda path: os.truncate(path, 20), lambda path: os.truncate(path, 0)]
)
def test_without_a_whole_checkpoint_every_damaged_one_is_named(tmp_path, whole, damage):
    run = shutil.copytree(whole["ppo"], tmp_path / "run")
    paths = sorted(run.glob("checkpoint-*"))
    for path in paths:
        damage(path)
    with pytest.raises(RunError, match="no undamaged checkpoint") as error:
        train(run)
    assert all(str(path) in str(error.value) for path in paths)


def test_a_diverged_training_names_the_causes(tmp_path):
    begin(tmp_path / "run", small("ppo", learning_rate=1e30))
    with pytest.raises(
        RunError, match="diverged, its weights are not finite: learning_rate is too large, or"
    ):
        train(tmp_path / "run")


def change(run, name, value):
    content = json.loads((run / "config.json").read_text())
    content["hyperparameters"][name] = value
    (run / "config.json").write_text(json.dumps(content))


UNFIT = {
    "hidden must stay 8 as in checkpoint-": lambda run: change(run, "hidden", 10**3),
    "is invalid: ValueError: .*'nope'": lambda run: change(run, "controller", "baselines:nope"),
    "no checkpoint to resume from": lambda run: [
        path.unlink() for path in run.glob("checkpoint-*")
    ],
}


@pytest.mark.parametrize("message", UNFIT)
def test_a_folder_that_has_been_changed_is_not_trained_further(tmp_path, capsys, whole, message):
    run = shutil.copytree(whole["ppo"], tmp_path / "run")
    UNFIT[message](run)
    before = (run / "model.zip").read_bytes()
    assert command_line.main(["--resume", str(run), "--no-comparison"]) == 2
    error = capsys.readouterr().err
    assert re.match(f"train.py: error: .*{message}", error) and error.count("\n") == 1
    assert (run / "model.zip").read_bytes() == before


def test_a_run_is_trained_by_one_process_at_a_time(tmp_path, capsys, whole):
    run = shutil.copytree(whole["ppo"], tmp_path / "run")
    code = f"from agents.training.checkpoint import *\nwith locked(Path({str(run)!r})): print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert (
            holder.stdout.read(1)
            and command_line.main(["--resume", str(run), "--no-comparison"]) == 2
        )
        holder.kill()
    out, error = capsys.readouterr()
    assert f"{run} is being trained by another process" in error and error.count("\n") == 1
    assert out == f"Resuming {run} (seed 0) until 800 steps.\n"
    with locked(run):
        pass


BROKEN = {
    "half": '{"algo": "ppo", ',
    "deeply nested": "[" * 100_000,
    "unknown task": '{"task": "walk", "algo": "ppo", "hyperparameters": {}}',
    "unknown hyperparameter": '{"task": "direct", "algo": "ppo", "hyperparameters": {"colour": 1}}',
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_configuration_is_named(tmp_path, capsys, content):
    (tmp_path / "config.json").write_text(content)
    with pytest.raises(RunError, match=r"config\.json"):
        read_config(tmp_path)
    with pytest.raises(SystemExit, match=r"^2$"):
        command_line.main(["--resume", str(tmp_path)])
    assert re.match(r"train.py: error: .*config\.json", capsys.readouterr().err.splitlines()[-1])


# The last one takes 9 PiB.
REFUSED = [
    "--controller baselines:adaptve",
    "--gamma 2",
    "--learning-rate nan",
    "--seed 5000000000",
]
REFUSED += ["--n-steps 1 --num-envs 1", "--algo sac --tau 0", "--algo tqc --dropped-quantiles 25"]
REFUSED += ["--algo sac --buffer-size 100_000_000_000_000"]


@pytest.mark.parametrize("arguments", [each.split() for each in REFUSED], ids=REFUSED)
def test_what_cannot_be_trained_makes_no_folder(tmp_path, capsys, arguments):
    run = tmp_path / "runs" / "run"
    assert (
        command_line.main(["--total-steps", "64", "--no-comparison", *arguments, "--run", str(run)])
        == 2
    )
    error = capsys.readouterr().err
    assert error.startswith("train.py: error: ") and error.count("\n") == 1
    named = arguments[2] if arguments[0] == "--algo" else arguments[0]
    assert named[2:].replace("-", "_") in error or "buffer_size" in arguments[-2].replace("-", "_")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_got_no_configuration_can_be_started_again(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(
            loop, "write_atomically", Mock(side_effect=OSError(28, "No space left on device"))
        )
        with pytest.raises(OSError, match="No space left"):
            begin(tmp_path / "run", small("ppo"))
    begin(tmp_path / "run", small("ppo"))
    assert read_config(tmp_path / "run") == small("ppo")


def test_of_two_runs_that_begin_in_one_folder_the_second_is_refused(tmp_path, monkeypatch):
    run, (first, second) = (
        tmp_path / "run",
        (small("ppo", learning_rate=rate) for rate in (1e-3, 1e-5)),
    )

    def begun_meanwhile(*arguments):
        monkeypatch.undo()
        begin(run, first)
        return loop.make_model(*arguments)

    monkeypatch.setattr(loop, "make_model", begun_meanwhile)
    with pytest.raises(FileExistsError):
        begin(run, second)
    assert read_config(run) == first and train(run)


def test_the_second_signal_does_what_signals_did_before(capfd):
    heard = []
    before = signal.signal(signal.SIGTERM, lambda *_: heard.append("before"))
    try:
        with Stop() as stop:
            assert not stop.requested
            signal.raise_signal(signal.SIGTERM)
            assert stop.requested and not heard
            signal.raise_signal(signal.SIGTERM)
            assert heard == ["before"]
        with Stop() as stop:
            pass
        signal.raise_signal(signal.SIGTERM)
        assert heard == ["before"] * 2 and not stop.requested
        with Stop() as outer, Stop():
            signal.raise_signal(signal.SIGTERM)
            assert outer.requested
    finally:
        signal.signal(signal.SIGTERM, before)
    assert capfd.readouterr().err.count("once more") == 2


# One process imports the modules, and is forked for each child.
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["agents.training.loop", "train"])


def run_command(words, output, largest):
    """In the child: runs train.py; no file may grow beyond the largest size."""
    command_line.QUIET_EXIT.install()
    os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT), 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, resource.RLIM_INFINITY))
    sys.exit(command_line.main(words))


def resumed(run, largest=resource.RLIM_INFINITY):
    """A process that resumes a run."""
    words = ["--resume", str(run), "--no-comparison"]
    process = CONTEXT.Process(target=run_command, args=(words, run.with_name("error"), largest))
    process.start()
    return process


MOMENTS = [
    (signal.SIGKILL, ".checkpoint-*"),
    (signal.SIGTERM, "checkpoint-*"),
    (signal.SIGINT, "error"),
]


@pytest.mark.parametrize(
    ("number", "pattern"), MOMENTS, ids=["while writing", "while training", "at the start"]
)
def test_a_process_that_gets_a_signal_loses_nothing_before_its_last_checkpoint(
    tmp_path, whole, number, pattern
):
    begin(tmp_path / "run", small("ppo"))
    run, process = tmp_path / "run", resumed(tmp_path / "run")
    while process.is_alive() and not any(tmp_path.rglob(pattern)):
        time.sleep(1e-4)
    os.kill(process.pid, number)
    process.join(240.0)
    assert process.exitcode in ((0, -number) if number == signal.SIGKILL else (0, INTERRUPTED))
    assert "Traceback" not in (tmp_path / "error").read_text()
    assert all(map(checkpoint.is_whole, run.glob("checkpoint-*")))
    assert train(run) and differences(run, whole["ppo"]) == []


def test_a_full_disk_ends_a_training_with_one_line_and_damages_nothing(
    tmp_path, monkeypatch, whole
):
    begin(tmp_path / "run", small("ppo"))
    train_until(run := tmp_path / "run", 300, monkeypatch, killed=True)
    process = resumed(run, largest=10_000)
    process.join(240.0)
    error = (tmp_path / "error").read_text()
    assert process.exitcode == 2 and re.fullmatch(rf"train.py: error: .*{run}.*\n", error), error
    assert all(map(checkpoint.is_whole, run.glob("checkpoint-*")))
    assert train(run) and differences(run, whole["ppo"]) == []
