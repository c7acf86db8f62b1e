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

SHORT = dict(total_steps=800, evaluation_episodes=1, evaluate_every=200)
ON_POLICY = SHORT | dict(n_steps=16, n_epochs=1, episode_seconds=0.2, randomization="wide")
OFF_POLICY = SHORT | dict(learning_starts=150, buffer_size=600, gradient_steps=1, noise_time=0.25)
SETTINGS = {
    "ppo": ON_POLICY,
    "recurrentppo": ON_POLICY | dict(lstm_units=4),
    "sac": OFF_POLICY | dict(n_steps=3, action_noise=0.2),
    "td3": OFF_POLICY,
}


def small(algo, **changes):
    return make_config("residual", algo, **SETTINGS[algo] | changes)


def steps_of(run):
    return max(map(checkpoint.steps_of, checkpoints(run)), default=0)


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
    folder = tmp_path_factory.mktemp("whole")
    return {algo: finished(folder / algo, small(algo)) for algo in SETTINGS}


@pytest.fixture
def run(tmp_path, whole):
    """A copy of the undisturbed run of PPO."""
    return shutil.copytree(whole["ppo"], tmp_path / "run")


@pytest.fixture
def begun(tmp_path):
    """A new run of PPO."""
    begin(tmp_path / "run", small("ppo"))
    return tmp_path / "run"


def checkpoints(run):
    return sorted(run.glob("checkpoint-*"))


def assert_resumes(run, whole):
    """Asserts that no checkpoint is damaged, and that the run ends like the undisturbed one."""
    assert all(map(checkpoint.is_whole, checkpoints(run)))
    assert train(run)
    assert differences(run, whole) == []


@pytest.mark.parametrize("algo", SETTINGS)
def test_a_run_that_was_killed_and_stopped_ends_like_an_undisturbed_one(
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
    random.random()
    np.random.random()
    torch.rand(1)
    assert_resumes(run, whole[algo])
    assert scalars(run) == scalars(whole[algo])
    assert len(checkpoints(run)) == 2
    assert all(map(checkpoint.is_whole, checkpoints(run)))


def test_a_run_that_was_stopped_before_its_first_step_ends_like_an_undisturbed_one(
    begun, monkeypatch, whole
):
    start = callbacks.TrainingCallback._on_training_start

    def interrupted(self):
        start(self)
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(callbacks.TrainingCallback, "_on_training_start", interrupted)
        assert not train(begun)
    assert [checkpoint.steps_of(path) for path in checkpoints(begun)] == [0]
    assert_resumes(begun, whole["ppo"])


def test_all_random_streams_go_on(whole):
    latest = checkpoints(whole["ppo"])[-1]
    model, _, restore_streams = checkpoint.restore(latest, PPO, make_env(small("ppo"), 0))
    model.set_logger(Logger(None, []))

    def draws():
        restore_streams()
        action = model.action_space.sample()[0]
        return random.random(), np.random.random(), torch.rand(1).item(), action

    assert draws() == draws()


def test_evaluations_leave_the_training_alone(tmp_path, whole):
    run = finished(tmp_path / "run", small("ppo", evaluate_every=10_000))
    assert parameters(run / "model.zip") == parameters(whole["ppo"] / "model.zip")


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_a_run_goes_on_from_the_checkpoint_before_a_damaged_one(run, capsys, whole):
    older, newer = checkpoints(run)
    flip(newer)
    (run / "model.zip").unlink()
    assert train(run)
    assert f"{newer} is damaged" in capsys.readouterr().err
    assert differences(run, whole["ppo"]) == []
    assert checkpoints(run) == [older, newer]
    assert checkpoint.is_whole(newer)


def test_partial_files_of_a_killed_process_are_removed(run):
    name = checkpoints(run)[0].name
    partial = [
        run / ".model.77.tmp.zip",
        run / "best" / ".policy.77.tmp.safetensors",
        run / f".{name[:20]}.77.tmp",
    ]
    # Of a process that needs no lock.
    others = [run / ".report.78.tmp.html", run / f"{name}.bak"]
    for path in (*partial, *others):
        path.write_bytes(b"half")
    assert train(run)
    assert not any(path.exists() for path in partial)
    assert all(path.exists() for path in others)


@pytest.mark.parametrize(
    "damage", [flip, lambda path: os.truncate(path, 20), lambda path: os.truncate(path, 0)]
)
def test_without_a_whole_checkpoint_every_damaged_one_is_named(run, damage):
    for path in checkpoints(run):
        damage(path)
    with pytest.raises(RunError, match="no undamaged checkpoint") as error:
        train(run)
    assert all(str(path) in str(error.value) for path in checkpoints(run))


def test_a_diverged_training_names_the_causes(tmp_path):
    begin(tmp_path / "run", small("ppo", learning_rate=1e30))
    message = "diverged, its weights are not finite: learning_rate is too large, or"
    with pytest.raises(RunError, match=message):
        train(tmp_path / "run")


def change(run, name, value):
    content = json.loads((run / "config.json").read_text())
    content["hyperparameters"][name] = value
    (run / "config.json").write_text(json.dumps(content))


def remove_checkpoints(run):
    for path in checkpoints(run):
        path.unlink()


def resume(run):
    return command_line.main(["--resume", str(run), "--no-comparison"])


UNFIT = {
    "hidden must stay 8 as in checkpoint-": lambda run: change(run, "hidden", 10**3),
    "is invalid: ValueError: .*'nope'": lambda run: change(run, "controller", "baselines:nope"),
    "no checkpoint to resume from": remove_checkpoints,
}


@pytest.mark.parametrize("message", UNFIT)
def test_a_folder_that_has_been_changed_is_not_trained_further(run, capsys, message):
    UNFIT[message](run)
    before = (run / "model.zip").read_bytes()
    assert resume(run) == 2
    assert re.fullmatch(f"train.py: error: .*{message}.*\n", capsys.readouterr().err)
    assert (run / "model.zip").read_bytes() == before


HOLD_LOCK = """
import sys
from pathlib import Path
from agents.training.checkpoint import locked

with locked(Path(sys.argv[1])):
    print(flush=True)
    input()
"""


def test_a_run_is_trained_by_one_process_at_a_time(run, capsys):
    command = [sys.executable, "-c", HOLD_LOCK, str(run)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.read(1)
        status = resume(run)
        holder.kill()
    assert status == 2
    out, error = capsys.readouterr()
    assert re.fullmatch(f".*{run} is being trained by another process.*\n", error)
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
def test_a_broken_configuration_is_named(tmp_path, refused, content):
    (tmp_path / "config.json").write_text(content)
    with pytest.raises(RunError, match=r"config\.json"):
        read_config(tmp_path)
    error = refused(command_line.main, ["--resume", str(tmp_path)]).splitlines()[-1]
    assert re.match(r"train.py: error: .*config\.json", error)


REFUSED = {
    "--controller baselines:adaptve": "controller",
    "--gamma 2": "gamma",
    "--learning-rate nan": "learning_rate",
    "--seed 5000000000": "seed must be an integer >= 0 and <= 4294967295, got 5000000000",
    "--batch-size 1": "batch_size must be an integer >= 2, got 1",
    "--n-steps 1 --num-envs 1": "n_steps",
    "--algo sac --tau 0": "tau",
    "--algo tqc --dropped-quantiles 25": "dropped_quantiles",
    "--algo recurrentppo --privileged": "privileged",
    "--algo recurrentppo --gamma 2": "gamma",
    # 9 PiB, of which numpy names the shape.
    "--algo sac --buffer-size 100_000_000_000_000": "Error",
}


@pytest.mark.parametrize(("words", "named"), REFUSED.items())
def test_what_cannot_be_trained_makes_no_folder(tmp_path, capsys, words, named):
    run = tmp_path / "runs" / "run"
    options = ["--total-steps", "64", "--no-comparison", "--run", str(run)]
    assert command_line.main([*words.split(), *options]) == 2
    assert re.fullmatch(f"train.py: error: .*{named}.*\n", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_got_no_configuration_can_be_started_again(tmp_path, monkeypatch):
    full_disk = Mock(side_effect=OSError(28, "No space left on device"))
    with monkeypatch.context() as patch:
        patch.setattr(loop, "write_atomically", full_disk)
        with pytest.raises(OSError, match="No space left"):
            begin(tmp_path / "run", small("ppo"))
    begin(tmp_path / "run", small("ppo"))
    assert read_config(tmp_path / "run") == small("ppo")


def test_of_two_runs_that_begin_in_one_folder_the_second_is_refused(tmp_path, monkeypatch):
    run = tmp_path / "run"
    first, second = (small("ppo", learning_rate=rate) for rate in (1e-3, 1e-5))

    def begun_meanwhile(*arguments):
        monkeypatch.undo()
        begin(run, first)
        return loop.make_model(*arguments)

    monkeypatch.setattr(loop, "make_model", begun_meanwhile)
    with pytest.raises(FileExistsError):
        begin(run, second)
    assert read_config(run) == first
    assert train(run)


@pytest.fixture
def heard():
    """A Mock that handles SIGTERM."""
    handler = Mock()
    before = signal.signal(signal.SIGTERM, handler)
    yield handler
    signal.signal(signal.SIGTERM, before)


def test_the_second_signal_does_what_signals_did_before(heard, capfd):
    with Stop() as stop:
        assert not stop.requested
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested
        assert not heard.called
        signal.raise_signal(signal.SIGTERM)
        assert heard.call_count == 1
    assert capfd.readouterr().err.count("once more") == 1


def test_after_the_context_signals_do_what_they_did_before(heard):
    with Stop() as stop:
        pass
    signal.raise_signal(signal.SIGTERM)
    assert heard.call_count == 1
    assert not stop.requested


def test_a_signal_stops_the_outer_context_too(heard, capfd):
    with Stop() as outer, Stop():
        signal.raise_signal(signal.SIGTERM)
        assert outer.requested
    assert capfd.readouterr().err.count("once more") == 1


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


# Signal, the file that exists at the moment of the signal, and the exit status.
MOMENTS = {
    "while writing": (signal.SIGKILL, ".checkpoint-*", -signal.SIGKILL),
    "while training": (signal.SIGTERM, "checkpoint-*", INTERRUPTED),
    "at the start": (signal.SIGINT, "error", INTERRUPTED),
}


@pytest.mark.parametrize(("number", "pattern", "status"), MOMENTS.values(), ids=MOMENTS)
def test_a_process_that_gets_a_signal_loses_nothing_before_its_last_checkpoint(
    tmp_path, begun, whole, number, pattern, status
):
    process = resumed(begun)
    while process.is_alive() and not any(tmp_path.rglob(pattern)):
        time.sleep(1e-4)
    os.kill(process.pid, number)
    process.join(240.0)
    # 0 if the training was complete before the signal.
    assert process.exitcode in (0, status)
    assert "Traceback" not in (tmp_path / "error").read_text()
    assert_resumes(begun, whole["ppo"])


def test_a_full_disk_ends_a_training_with_one_line_and_damages_nothing(
    tmp_path, begun, monkeypatch, whole
):
    train_until(begun, 300, monkeypatch, killed=True)
    process = resumed(begun, largest=10_000)
    process.join(240.0)
    error = (tmp_path / "error").read_text()
    assert process.exitcode == 2
    assert re.fullmatch(rf"train.py: error: .*{begun}.*\n", error), error
    assert_resumes(begun, whole["ppo"])
