"""Configurations small enough to train within a test, and comparisons of runs, bit for bit."""

import csv
import dataclasses
import io
import itertools
import signal
from pathlib import Path

import pytest
import torch
from stable_baselines3.common.save_util import load_from_zip_file

from agents.training.callbacks import TrainingCallback
from agents.training.config import ALGORITHMS, PPOConfig
from agents.training.loop import begin, train
from agents.training.presets import PRESETS
from capsule_gym import load_policy
from capsule_gym.policies.policy import POLICY, TRAINING_STARTS

SMALL = dict(
    num_envs=8,
    batch_size=64,
    hidden=8,
    evaluation_episodes=2,
    evaluate_every=10_000,
)
SMALL_PPO = SMALL | dict(n_steps=32, n_epochs=2)
SMALL_OFF_POLICY = SMALL | dict(learning_starts=300, buffer_size=2000)
# Columns with times, and with counts since the last resumption.
CLOCKS = ("core_seconds", "time/fps", "time/time_elapsed", "time/iterations")


def small(action_mode, algo, **changes):
    on_policy = issubclass(ALGORITHMS[algo], PPOConfig)
    settings = SMALL_PPO if on_policy else SMALL_OFF_POLICY
    return dataclasses.replace(PRESETS[action_mode, algo], **settings | changes)


def evaluated(env_kwargs):
    """The arguments of a training without its random starts, as those of its policy."""
    return {name: value for name, value in env_kwargs.items() if name not in TRAINING_STARTS}


def finished(folder, config):
    """A complete run."""
    begin(folder, config)
    assert train(folder)
    return folder


class Killed(BaseException):
    """Ends a training in the middle of a rollout."""


def train_until(run, steps, monkeypatch, *, killed):
    """Trains, and kills the training after so many agent steps or sends it Ctrl-C."""
    step = TrainingCallback._on_step

    def stopped(self):
        if self.num_timesteps >= steps and not self.stop.requested:
            if killed:
                raise Killed
            signal.raise_signal(signal.SIGINT)
        return step(self)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingCallback, "_on_step", stopped)
        if killed:
            with pytest.raises(Killed):
                train(run)
        else:
            assert not train(run)


def parameters(archive):
    """Networks and optimisers of an archive as bytes, loaded without unpickling."""
    _, *parameters = load_from_zip_file(archive, load_data=False, device="cpu")
    content = io.BytesIO()
    torch.save(parameters, content)
    return content.getvalue()


def network(folder):
    """The policy's parameters in a folder as bytes, without the name of the run; empty if the
    folder has no policy."""
    if not (folder / POLICY).is_file():
        return b""
    policy = load_policy(folder / POLICY)
    arrays = itertools.chain(
        (policy.mean, policy.variance), *policy.layers, policy.cell or (), *policy.head
    )
    return b"".join(array.tobytes() for array in arrays)


def rows(path):
    """The complete lines of a CSV file, without empty fields and times."""
    found = []
    for row in csv.DictReader(path.read_text().splitlines()):
        if None not in row.values():
            found.append({name: row[name] for name in row if row[name] and name not in CLOCKS})
    return found


def log(run):
    """The lines of a run's log by agent steps; a resumed process writes the lines after its first
    step again."""
    found = {}
    for path in sorted((run / "logs").glob("progress-*.csv")):
        first = int(path.stem.removeprefix("progress-"))
        found = {steps: row for steps, row in found.items() if steps <= first}
        for row in rows(path):
            found[int(row["time/total_timesteps"])] = row
    return found


def differences(run, other):
    """The files in which two finished runs differ."""
    found = []
    for folder in (Path(), Path("best")):
        if parameters(run / folder / "model.zip") != parameters(other / folder / "model.zip"):
            found.append(str(folder / "model.zip"))
        if network(run / folder) != network(other / folder):
            found.append(str(folder / POLICY))
    if rows(run / "evaluations.csv") != rows(other / "evaluations.csv"):
        found.append("evaluations.csv")
    if log(run) != log(other):
        found.append("logs")
    return found
