"""What a run writes while it trains, also where it cannot."""

from __future__ import annotations

import csv
import json
import sys
import threading
from types import SimpleNamespace

import pytest

from agents.training import checkpoint
from agents.training.callbacks import make_logger, quiet_tensorboard
from agents.training.loop import begin, train
from agents.training.presets import RunError
from tests.agents.training.small import small


def full(*_):
    raise OSError(28, "No space left on device")


# Pytest has a hook of its own for what threads let out.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_full_disk_under_tensorboard_is_said_once_by_who_writes_next(tmp_path, monkeypatch):
    hooked = []
    monkeypatch.setattr(threading, "excepthook", hooked.append)
    with quiet_tensorboard():
        logger = make_logger(tmp_path, small("direct", "ppo"), 0, wandb=False)
        events = logger.output_formats[1]
        writer = events.writer.file_writer.event_writer._async_writer
        monkeypatch.setattr(writer._writer, "write", full)
        with pytest.raises(OSError, match="No space left on device"):
            for step in range(100):
                logger.record("a", step)
                logger.dump(step)
        writer._worker.join()
        assert hooked == []
        # Whatever else a thread meets is said as ever.
        other = threading.Thread(target=full)
        other.start()
        other.join()
        assert [failure.thread for failure in hooked] == [other]
    assert threading.excepthook == hooked.append


WATCHED = ("cost_of_transport", "stuck_fraction", "reward_progress", "reward_energy", "reward_termination")


class FakeWandb(SimpleNamespace):
    """What of wandb is used; remembers what it is told."""

    def __init__(self) -> None:
        super().__init__(begun=[], lines=[], finished=0, errors=SimpleNamespace(Error=ConnectionError))

    def init(self, **settings):
        self.begun.append(settings)
        return self

    def log(self, values, step):
        self.lines.append((step, values))

    def finish(self):
        self.finished += 1


def train_briefly(folder, **options):
    config = small("direct", "ppo", total_steps=768, evaluate_every=256, episode_seconds=0.4)
    if not folder.exists():
        begin(folder, config)
    return config, train(folder, config, **options)


def test_the_log_says_what_the_episodes_cost_and_are_paid_for(tmp_path):
    config, finished = train_briefly(tmp_path / "run")
    assert finished
    with (tmp_path / "run" / "logs" / "progress.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    # Episodes that get nowhere have an infinite cost, which is not logged.
    names = {f"episodes/{name}" for name in WATCHED if name != "cost_of_transport"} | {"evaluation/stuck_fraction"}
    assert names <= set(lines[-1])
    assert 0.0 <= float(lines[-1]["episodes/stuck_fraction"]) <= 1.0
    latest = checkpoint.newest(tmp_path / "run")
    progress = json.loads((latest / "progress.json").read_text())
    recent = progress["recent"]
    assert set(recent) == set(WATCHED)
    for failed, energy, failure in zip(
        progress["failed"], recent["reward_energy"], recent["reward_termination"], strict=True
    ):
        assert energy <= 1e-4
        assert failure == -config.termination_penalty * failed


def test_weights_and_biases_is_told_the_same_lines(tmp_path, monkeypatch):
    fake = FakeWandb()
    monkeypatch.setitem(sys.modules, "wandb", fake)
    config, _ = train_briefly(tmp_path / "run", wandb=True)
    assert fake.begun[0]["name"] == "run" and fake.begun[0]["config"] == config.to_dict() and fake.finished == 1
    steps = [step for step, _ in fake.lines]
    assert steps == sorted(steps) and steps[-1] == 768
    assert "episodes/mean_speed" in fake.lines[-1][1] and "evaluation/score" in {k for _, v in fake.lines for k in v}
    # Gone on with, it is the same run there.
    train_briefly(tmp_path / "run", wandb=True)
    assert fake.begun[1]["id"] == fake.begun[0]["id"] and fake.begun[0]["resume"] == "allow"


def test_weights_and_biases_is_not_needed_unless_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(RunError, match=r'pip install "capsule-gym\[wandb\]"'):
        train_briefly(tmp_path / "run", wandb=True)
    assert train_briefly(tmp_path / "run")[1]


def test_what_weights_and_biases_refuses_is_an_error_of_the_run(tmp_path, monkeypatch):
    fake = FakeWandb()
    monkeypatch.setattr(fake, "init", lambda **settings: (_ for _ in ()).throw(ConnectionError("no key")))
    monkeypatch.setitem(sys.modules, "wandb", fake)
    with pytest.raises(RunError, match="no key"):
        train_briefly(tmp_path / "run", wandb=True)
