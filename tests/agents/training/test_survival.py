"""Training that survives: a run that goes on is the same run, and what lies on the disk is whole at any moment."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import train as command_line
from agents.fast_ppo import FastPPO
from agents.training import callbacks, checkpoint, loop
from agents.training.algorithms import make_env
from agents.training.callbacks import Events, Table, TrainingCallback
from agents.training.checkpoint import locked
from agents.training.loop import begin, train
from agents.training.presets import PRESETS, Config, RunError, read_config
from agents.training.signals import Stop
from tests.agents.training.small import differences, parameters, rows, same

SMALL = {"num_envs": 8, "batch_size": 64, "hidden": 8, "evaluation_episodes": 2, "evaluate_every": 300}
ON_POLICY: dict[str, Any] = {"n_steps": 32, "n_epochs": 2, "total_steps": 1400}
OFF_POLICY: dict[str, Any] = {"learning_starts": 200, "buffer_size": 800, "gradient_steps": 1, "total_steps": 1400}
EVERY_OPTION: dict[str, Any] = {
    "identifies": True,
    "privileged_critic": True,
    "energy_weights": (0.1, 10.0),
    "jump_rate": 2.0,
    "randomization": "wide",
    "tanh_mean": True,
    "least_log_std": -0.4,
    "critic_steps": 600,
}
OWN = {
    "ppo": {**ON_POLICY, "episode_seconds": 0.5},
    "ppo with every option": {**ON_POLICY, "episode_seconds": 0.4, **EVERY_OPTION},
    "sac": OFF_POLICY,
    # Random actions end the episodes that a log needs; those of its first policy end none.
    "td3": {**OFF_POLICY, "learning_starts": 500},
    "recurrent-ppo": ON_POLICY,
    "tqc": OFF_POLICY,
}


def small(name: str, **changes: Any) -> Config:
    return dataclasses.replace(PRESETS["residual", name.split()[0]], **{**SMALL, **OWN[name], **changes})


class Killed(BaseException):
    """Ends a training where it stands."""


def kill_at(monkeypatch, steps: int | None) -> None:
    """Lets the next training die after so many agent steps, in the middle of a rollout; None lets it live."""
    step = TrainingCallback._on_step

    def dying(self) -> bool:
        if steps is not None and self.num_timesteps >= steps:
            raise Killed
        return step(self)

    monkeypatch.setattr(TrainingCallback, "_on_step", dying if steps is not None else step)


def interrupt_at(monkeypatch, steps: int) -> None:
    """Sends the next training Ctrl-C after so many agent steps."""
    step = TrainingCallback._on_step

    def interrupted(self) -> bool:
        if not self.stop.requested and self.num_timesteps >= steps:
            os.kill(os.getpid(), signal.SIGINT)
        return step(self)

    monkeypatch.setattr(TrainingCallback, "_on_step", interrupted)


def new_run(folder: Path, config: Config) -> Path:
    begin(folder, config)
    return folder


def scalars(run: Path, tag: str) -> list[tuple[int, float]]:
    events = EventAccumulator(str(run / "logs"))
    events.Reload()
    return [(event.step, event.value) for event in events.Scalars(tag)]


@pytest.fixture(scope="module", autouse=True)
def _short_runs_write_a_log():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(callbacks, "LOG_EVERY", 200)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, Path]:
    """A run of each algorithm that nobody disturbed."""
    runs = {}
    for algo in OWN:
        runs[algo] = new_run(tmp_path_factory.mktemp("whole") / algo, small(algo))
        assert train(runs[algo], small(algo))
    return runs


@pytest.mark.parametrize("algo", OWN)
def test_a_run_that_was_killed_and_stopped_ends_with_the_same_policy(tmp_path, monkeypatch, whole, algo):
    config = small(algo)
    run = new_run(tmp_path / "run", config)
    # Before the first checkpoint, after it, and long enough after Ctrl-C for another one.
    with monkeypatch.context() as patch:
        kill_at(patch, 200)
        with pytest.raises(Killed):
            train(run, config)
    assert checkpoint.newest(run) is None
    next_second()
    with monkeypatch.context() as patch:
        kill_at(patch, 590)
        with pytest.raises(Killed):
            train(run, config)
    assert 300 <= steps_of(checkpoint.newest(run)) < 590
    next_second()
    with monkeypatch.context() as patch:
        interrupt_at(patch, 620)
        assert not train(run, config)
    stopped = steps_of(checkpoint.newest(run))
    assert 620 <= stopped < 1000
    # Random numbers drawn in between belong to nobody.
    for draw in (random.random, np.random.random, lambda: torch.rand(1)):
        draw()
    next_second()
    assert train(run, config)
    assert differences(run, whole[algo]) == []
    assert scalars(run, "episodes/mean_speed") == scalars(whole[algo], "episodes/mean_speed")
    progress = json.loads((checkpoint.newest(run) / "progress.json").read_text())
    assert len(progress["resumed_at"]) == 2 and progress["resumed_at"][-1] == stopped


def next_second() -> None:
    """TensorBoard takes a run's files in the order of the second that each was begun in."""
    time.sleep(1.01 - time.time() % 1.0)


def steps_of(folder: Path | None) -> int:
    assert folder is not None
    return int(folder.name.split("-")[1])


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_evaluations_leave_the_training_alone(tmp_path, whole, algo):
    config = small(algo, evaluate_every=10_000)
    run = new_run(tmp_path / "run", config)
    assert train(run, config)
    assert same(parameters(run / "model.zip"), parameters(whole[algo] / "model.zip"))


def test_the_last_two_checkpoints_are_kept(whole):
    for run in whole.values():
        assert len(list(run.glob("checkpoint-*"))) == 2
        for folder in run.glob("checkpoint-*"):
            assert checkpoint.damage(folder) is None
            listed = json.loads((folder / "manifest.json").read_text())["sha256"]
            present = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
            assert set(listed) == present - {"manifest.json"}


def copy_of(run: Path, folder: Path) -> Path:
    subprocess.run(["cp", "-r", str(run), str(folder)], check=True)
    return folder


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGE = {
    "truncated model": lambda folder: truncate(folder / "model.zip"),
    "one bit of the state": lambda folder: flip(folder / "state.pkl"),
    "missing progress": lambda folder: (folder / "progress.json").unlink(),
    "missing best model": lambda folder: (folder / "best" / "model.zip").unlink(),
    "missing manifest": lambda folder: (folder / "manifest.json").unlink(),
    "half a manifest": lambda folder: truncate(folder / "manifest.json"),
    "manifest of another kind": lambda folder: (folder / "manifest.json").write_text("[1]"),
    "manifest of a later format": lambda folder: (folder / "manifest.json").write_text('{"format": 9, "sha256": {}}'),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_damaged_checkpoint_gives_way_to_the_one_before(tmp_path, capsys, whole, damage):
    run = copy_of(whole["ppo"], tmp_path / "run")
    older, newer = sorted(run.glob("checkpoint-*"))
    if damage is DAMAGE["half a manifest"]:
        # The last character is a line break.
        truncate(newer / "manifest.json")
    damage(newer)
    assert checkpoint.newest_whole(run) == older
    warning = capsys.readouterr().err
    assert str(newer) in warning and older.name in warning and warning.count("\n") == 1
    damage(older)
    if damage is DAMAGE["half a manifest"]:
        truncate(older / "manifest.json")
    with pytest.raises(RunError, match="no whole checkpoint") as error:
        checkpoint.newest_whole(run)
    assert str(newer) in str(error.value) and str(older) in str(error.value)


def test_a_run_goes_on_from_the_checkpoint_before_a_damaged_one(tmp_path, capsys, whole):
    run = copy_of(whole["ppo"], tmp_path / "run")
    older, newer = sorted(run.glob("checkpoint-*"))
    truncate(newer / "model.zip")
    # What the end of the run had left does not count either.
    (run / "best" / "model.zip").write_bytes(b"")
    (run / "model.zip").unlink()
    assert train(run, small("ppo"))
    assert f"{newer} is damaged" in capsys.readouterr().err
    assert differences(run, whole["ppo"]) == []
    assert sorted(run.glob("checkpoint-*")) == [older, newer]
    assert checkpoint.damage(newer) is None


def test_a_checkpoint_that_cannot_be_written_leaves_the_others(tmp_path, whole):
    run = copy_of(whole["ppo"], tmp_path / "run")
    before = sorted(run.rglob("*"))

    def half(folder: Path) -> None:
        (folder / "model.zip").write_bytes(b"half")
        raise OSError(28, "No space left on device", str(folder / "state.pkl"))

    with pytest.raises(OSError, match=r"state\.pkl"):
        checkpoint.write(run, 10**6, half, checkpoint.newest(run))
    assert sorted(run.rglob("*")) == before


def test_a_folder_has_its_name_only_while_it_is_complete(tmp_path):
    def fill(folder: Path) -> None:
        assert folder.suffix == ".partial"
        assert [path.name for path in sorted(tmp_path.iterdir())] == [*names, folder.name]
        (folder / "a").write_text("a")

    names: list[str] = []
    last = None
    for steps in (5, 10, 20, 30):
        last = checkpoint.write(tmp_path, steps, fill, last)
        names = [*names, last.name][-2:]
        assert [path.name for path in sorted(tmp_path.iterdir())] == names
    # A damaged one of the same step makes room, and what follows an abandoned one goes.
    (last / "a").unlink()
    kept = tmp_path / names[0]
    names = []
    assert checkpoint.write(tmp_path, 30, lambda folder: (folder / "b").write_text("b"), kept) == last
    assert checkpoint.damage(last) is None and (last / "b").is_file()
    assert checkpoint.write(tmp_path, 25, lambda folder: None, kept).name in os.listdir(tmp_path)
    assert len(os.listdir(tmp_path)) == 2 and last.name not in os.listdir(tmp_path)


def test_what_a_killed_process_left_is_swept(tmp_path, whole):
    run = copy_of(whole["ppo"], tmp_path / "run")
    before = sorted(run.rglob("*"))
    for name in ("checkpoint-000000009999.partial", "checkpoint-000000000001.discarded"):
        (run / name).mkdir()
        (run / name / "model.zip").write_bytes(b"half")
    for name in (".model.77.tmp.zip", "best/.policy.77.tmp.safetensors"):
        (run / name).write_bytes(b"half")
    assert checkpoint.newest_whole(run) == max(run.glob("checkpoint-????????????"))
    checkpoint.clean_up(run)
    assert sorted(run.rglob("*")) == before


def test_a_checkpoint_that_cannot_be_understood_is_named(tmp_path, whole):
    for name, content in (("state.pkl", b"no pickle"), ("model.zip", b"no archive")):
        run = copy_of(whole["ppo"], tmp_path / name)
        folder = checkpoint.newest(run)
        (folder / name).write_bytes(content)
        with pytest.raises(RunError, match=name):
            checkpoint.restore(folder, FastPPO, make_env(small("ppo"), 0))
    (folder / "progress.json").write_text('{"elapsed": 1}')
    with pytest.raises(RunError, match=r"progress\.json"):
        checkpoint.Progress.read(folder)


def test_two_processes_cannot_train_one_run(tmp_path, capsys, whole):
    run = copy_of(whole["ppo"], tmp_path / "run")
    code = "import sys, time; from pathlib import Path; from agents.training.checkpoint import locked\n"
    code += f"with locked(Path({str(run)!r})): print('held', flush=True); time.sleep(600)"
    holder = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        assert command_line.main(["--resume", str(run), "--no-comparison"]) == 2
        error = capsys.readouterr().err
        assert f"{run} is being trained already" in error and error.count("\n") == 1
    finally:
        holder.kill()
        holder.communicate()
    # The system has let go of it.
    with locked(run):
        with pytest.raises(RunError, match="being trained already"), locked(run):
            pass


BROKEN = {
    "empty": "",
    "half": '{"algo": "ppo", ',
    "no object": "[]",
    "no algorithm": '{"task": "direct", "hyperparameters": {}}',
    "unknown algorithm": '{"task": "direct", "algo": "dqn", "hyperparameters": {}}',
    "unknown hyperparameter": '{"task": "direct", "algo": "ppo", "hyperparameters": {"colour": 1}}',
    "hyperparameters of another kind": '{"task": "direct", "algo": "ppo", "hyperparameters": 3}',
    "hyperparameter of another type": '{"task": "direct", "algo": "ppo", "hyperparameters": {"hidden": "many"}}',
    "hyperparameter out of range": '{"task": "direct", "algo": "ppo", "hyperparameters": {"gamma": 2.0}}',
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_configuration_is_named(tmp_path, capsys, content):
    (tmp_path / "config.json").write_text(content)
    with pytest.raises(RunError, match=r"config\.json"):
        read_config(tmp_path)
    with pytest.raises(SystemExit) as stop:
        command_line.main(["--resume", str(tmp_path)])
    assert stop.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("train.py: error: ")


def test_a_configuration_of_another_run_is_refused(whole):
    with pytest.raises(RunError, match=r"config\.json"):
        train(whole["ppo"], small("ppo", gamma=0.9))


REFUSED = [
    ["--controller", "baselines:adaptve"],
    ["--gamma", "2"],
    ["--batch-size", "1"],
    ["--learning-rate", "nan"],
    ["--final-learning-rate", "-1"],
    ["--seed", "5000000000"],
    ["--n-steps", "1", "--num-envs", "1"],
    ["--gae-lambda", "1.5"],
    ["--log-std-init", "inf"],
    ["--episode-seconds", "0"],
    ["--least-log-std", "3"],
    ["--energy-weights", "0", "1"],
    ["--energy-weights", "2", "1"],
    ["--torque-limit", "0"],
    ["--env-threads", "0"],
    ["--algo", "sac", "--tau", "0"],
    ["--algo", "td3", "--action-noise", "-1"],
    ["--algo", "tqc", "--dropped-quantiles", "25"],
    ["--algo", "sac", "--buffer-size", "3"],
    # 9 PiB.
    ["--algo", "sac", "--buffer-size", "100_000_000_000_000"],
]


@pytest.mark.parametrize("arguments", REFUSED, ids=" ".join)
def test_what_cannot_be_trained_makes_no_folder(tmp_path, capsys, arguments):
    run = tmp_path / "runs" / "run"
    assert command_line.main(["--total-steps", "64", "--no-comparison", *arguments, "--run", str(run)]) == 2
    # A law that is new to this machine is compiled before it can be checked, which is said.
    error = "\n".join(line for line in capsys.readouterr().err.splitlines() if not line.startswith("capsule_gym: "))
    assert error.startswith("train.py: error: ") and "\n" not in error
    named = arguments[2] if arguments[0] == "--algo" else arguments[0]
    assert named[2:].replace("-", "_") in error or "buffer_size" in arguments[-2].replace("-", "_")
    assert not list(tmp_path.iterdir())


def test_a_run_without_its_configuration_never_exists(tmp_path, monkeypatch):
    def full(path: Path, text: str) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(loop, "write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        begin(tmp_path / "run", small("ppo"))
    assert not list(tmp_path.iterdir())


def test_a_new_end_is_another_run_and_said_so(tmp_path, capsys, monkeypatch, whole):
    run = copy_of(whole["ppo"], tmp_path / "run")
    assert command_line.main(["--resume", str(run), "--total-steps", "2000", "--no-comparison"]) == 0
    assert "this is another run" in capsys.readouterr().out
    assert read_config(run).total_steps == 2000
    evaluations = [int(row["steps"]) for row in rows(run / "evaluations.csv")]
    assert evaluations[-1] >= 2000 and evaluations == sorted(set(evaluations))
    # From now on it is the end of this run.
    assert command_line.main(["--resume", str(run), "--no-comparison"]) == 0
    assert "this is another run" not in capsys.readouterr().out


def test_a_table_goes_on_where_it_was(tmp_path):
    path = tmp_path / "table.csv"
    table = Table(path, "steps", 0)
    table.add({"steps": 10, "a": 1.5})
    table.add({"steps": 20, "b": "x, y"})
    table.add({"steps": 30, "a": 2.5})
    assert rows(path) == [
        {"steps": "10", "a": "1.5", "b": ""},
        {"steps": "20", "a": "", "b": "x, y"},
        {"steps": "30", "a": "2.5", "b": ""},
    ]
    with path.open("a") as file:
        file.write("15,2.")
    again = Table(path, "steps", 20)
    again.add({"steps": 25, "c": 3})
    assert [(row["steps"], row["c"]) for row in rows(path)] == [("10", ""), ("20", ""), ("25", "3")]
    for content in ("", "ste", "\0\n\0\0\n"):
        path.write_text(content)
        Table(path, "steps", 20).add({"steps": 1})
        assert rows(path) == [{"steps": "1"}]


def test_events_of_a_part_that_is_trained_again_are_hidden(tmp_path):
    for until, steps in ((0, (10, 20, 30)), (20, (30, 40))):
        logger = Logger(str(tmp_path), [Events(tmp_path / "logs", until)])
        for step in steps:
            logger.record("a", float(until + step))
            logger.dump(step)
        logger.close()
    assert scalars(tmp_path, "a") == [(10, 10.0), (20, 20.0), (30, 50.0), (40, 60.0)]


def test_the_second_signal_does_what_signals_did_before(capfd):
    heard = []
    before = signal.signal(signal.SIGTERM, lambda *_: heard.append("before"))
    try:
        with Stop() as stop:
            assert not stop.requested
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.requested and not heard
            os.kill(os.getpid(), signal.SIGTERM)
            assert heard == ["before"]
        with Stop() as stop:
            pass
        os.kill(os.getpid(), signal.SIGTERM)
        assert heard == ["before"] * 2 and not stop.requested
    finally:
        signal.signal(signal.SIGTERM, before)
    assert capfd.readouterr().err.count("once more") == 1


def test_only_the_main_thread_handles_signals():
    handler = signal.getsignal(signal.SIGINT)
    seen = []

    def inside() -> None:
        with Stop():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert seen == [handler]
