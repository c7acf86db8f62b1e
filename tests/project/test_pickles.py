"""No command unpickles a file or folder that it is given, unless an option allows it."""

import base64
import hashlib
import importlib
import json
import pickle
import sys
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.study import train_job
from agents.training.presets import row_settings
from capsule_gym.evaluation.optimum import ARCHIVE, ARRAYS
from tests.agents.training.small import small
from tests.project.test_commands import commands

MARK = "unpickled"


class Touch:
    """A pickle of this object creates a file when it is loaded."""

    def __reduce__(self):
        return Path.touch, (Path(MARK),)


PICKLE = pickle.dumps(Touch())


def write_model(path):
    """Writes a Stable-Baselines3 model whose parts are all such pickles."""
    with zipfile.ZipFile(path, "w") as parts:
        data = {
            "policy_class": {":type:": "type", ":serialized:": base64.b64encode(PICKLE).decode()}
        }
        parts.writestr("data", json.dumps(data))
        for name in ("policy.pth", "policy.optimizer.pth", "pytorch_variables.pth"):
            parts.writestr(name, PICKLE)


def write_run(folder, algo, config=None):
    """Writes the folder of a run whose files are such pickles, except the configuration."""
    (folder / "best").mkdir(parents=True)
    settings = (config or small("direct", algo)).to_dict()
    (folder / "config.json").write_text(
        json.dumps({"task": "direct", "algo": algo, "hyperparameters": settings})
    )
    (folder / "evaluations.csv").write_text("steps,mean_speed_cm_s,failed\n512,1.0,0.0\n")
    for name in ("checkpoint-000000000512", "checkpoint-000000001024"):
        (folder / name).write_bytes(hashlib.sha256(PICKLE).digest() + PICKLE)
    for part in (folder, folder / "best"):
        write_model(part / "model.zip")
        for name in ("vecnormalize.pkl", "policy.safetensors"):
            (part / name).write_bytes(PICKLE)


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """A working folder with every kind of file and folder that a command may read."""
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "run", "ppo")
    write_run(tmp_path / "old", "sac")
    (tmp_path / "old" / "best" / "policy.safetensors").unlink()
    write_run(
        tmp_path / "study" / "direct-ppo" / "seed-0",
        "ppo",
        replace(row_settings("direct-ppo"), seed=0),
    )
    (tmp_path / "set.json").write_bytes(PICKLE)
    (tmp_path / "archive").mkdir()
    (tmp_path / "archive" / ARCHIVE).write_text('{"results": []}')
    np.savez(
        tmp_path / "archive" / ARRAYS,
        nominal=np.array([Touch()], object),
        values=np.array([Touch()], object),
    )
    (tmp_path / "empty").mkdir()
    write_model(tmp_path / "model.zip")
    (tmp_path / "policy.safetensors").write_bytes(PICKLE)
    return tmp_path


PATHS = (
    "run",
    "old",
    "run/best",
    "old/best",
    "old/best/model.zip",
    "model.zip",
    "policy.safetensors",
    "archive",
)
# The commands that read a path, with their arguments.
READERS = {
    "agents.evaluate": [
        *([path] for path in PATHS),
        ["pd", "--set", "set.json"],
        ["pd", "--against", "run"],
    ],
    "agents.study": [["direct-ppo", "--runs", "study", "--seeds", "0"]],
    "baselines.dynamic_programming": [
        ["--folder", name, "--report"] for name in ("archive", "empty")
    ],
    "capsule_gym.demo": [
        *([path, "-o", "a.gif"] for path in PATHS),
        *(
            ["adaptive", *words, "-o", "a.gif"]
            for words in (["--set", "set.json"], ["--rival", "run"])
        ),
    ],
    "capsule_gym.export": [[path, "--c", "policy.h"] for path in PATHS],
    "capsule_gym.identification": [["policy.safetensors"], ["model.zip"]],
    "train": [["--run", "run"], ["--run", "old", "--task", "direct", "--algo", "sac"]],
}
# The commands with an option that trusts the path.
TRUSTING = (
    ["agents.study", "direct-ppo", "--runs", "study", "--seeds", "0", "--resume"],
    ["train", "--resume", "run"],
)


def main_of(command):
    """The `main` function of a command."""
    module = importlib.import_module(command)
    return (
        module if hasattr(module, "main") else importlib.import_module(f"{command}.__main__")
    ).main


@pytest.mark.parametrize("command", READERS)
def test_nothing_is_unpickled_that_is_not_trusted(command, hostile, monkeypatch, capsys):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    for words in READERS[command]:
        with pytest.raises(SystemExit) as stop:
            sys.exit(main_of(command)(words))
        assert not Path(MARK).exists(), words
        assert stop.value.code != 0, words
        assert "Traceback" not in capsys.readouterr().err


def test_what_reads_a_path_is_among_these():
    """Every command is listed as one that reads a path, or as one that does not."""
    others = {name for name in commands() if name.startswith(("benchmarks", "tests", "web"))}
    only_written = {
        "agents.analysis",
        "agents.distillation",
        "agents.leaderboard",
        "baselines.tuning",
    }
    only_written |= {"baselines.paper", "baselines.paper.optimal_profiles"}
    assert set(commands()) == {*READERS, *others, *only_written}


@pytest.mark.parametrize("words", TRUSTING, ids=lambda words: words[0])
def test_an_option_says_what_is_trusted(words, hostile, monkeypatch):
    monkeypatch.setattr(
        "agents.study.train_all", lambda jobs, *_: {job: train_job(job) for job in jobs}
    )
    with suppress(BaseException):
        main_of(words[0])(words[1:])
    assert Path(MARK).exists()
