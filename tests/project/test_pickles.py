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
    serialized = base64.b64encode(PICKLE).decode()
    data = {"policy_class": {":type:": "type", ":serialized:": serialized}}
    with zipfile.ZipFile(path, "w") as parts:
        parts.writestr("data", json.dumps(data))
        for name in ("policy.pth", "policy.optimizer.pth", "pytorch_variables.pth"):
            parts.writestr(name, PICKLE)


def write_run(folder, algo, config=None):
    """Writes the folder of a run whose files are such pickles, except the configuration."""
    (folder / "best").mkdir(parents=True)
    settings = (config or small("direct", algo)).to_dict()
    run = {"task": "direct", "algo": algo, "hyperparameters": settings}
    (folder / "config.json").write_text(json.dumps(run))
    (folder / "evaluations.csv").write_text("steps,mean_speed_cm_s,failed\n512,1.0,0.0\n")
    signed = hashlib.sha256(PICKLE).digest() + PICKLE
    for name in ("checkpoint-000000000512", "checkpoint-000000001024"):
        (folder / name).write_bytes(signed)
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
    row = replace(row_settings("direct-ppo"), seed=0)
    write_run(tmp_path / "study" / "direct-ppo" / "seed-0", "ppo", row)
    (tmp_path / "set.json").write_bytes(PICKLE)
    archive = tmp_path / "archive"
    archive.mkdir()
    (archive / ARCHIVE).write_text('{"results": []}')
    pickled = np.array([Touch()], object)
    np.savez(archive / ARRAYS, nominal=pickled, values=pickled)
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
# The arguments of every command that reads a path.
READERS = {
    "agents.evaluate": [*PATHS, "pd --set set.json", "pd --against run"],
    "agents.study": ["direct-ppo --runs study --seeds 0"],
    "baselines.dynamic_programming": ["--folder archive --report", "--folder empty --report"],
    "capsule_gym.demo": [
        *(f"{path} -o a.gif" for path in PATHS),
        "adaptive --set set.json -o a.gif",
        "adaptive --rival run -o a.gif",
    ],
    "capsule_gym.export": [f"{path} --c policy.h" for path in PATHS],
    "capsule_gym.identification": ["policy.safetensors", "model.zip"],
    "train": ["--run run", "--run old --task direct --algo sac"],
}


def main_of(command):
    """The `main` function of a command."""
    module = importlib.import_module(command)
    if not hasattr(module, "main"):
        module = importlib.import_module(f"{command}.__main__")
    return module.main


@pytest.mark.parametrize("command", READERS)
def test_nothing_is_unpickled_that_is_not_trusted(command, hostile, monkeypatch, capsys):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    main = main_of(command)
    for line in READERS[command]:
        with pytest.raises(SystemExit) as stop:
            sys.exit(main(line.split()))
        assert not Path(MARK).exists(), line
        assert stop.value.code != 0, line
        assert "Traceback" not in capsys.readouterr().err


def test_every_command_is_listed_as_one_that_reads_a_path_or_only_writes():
    only_written = {
        "agents.analysis",
        "agents.distillation",
        "agents.information",
        "agents.leaderboard",
        "baselines.paper",
        "baselines.paper.optimal_profiles",
        "baselines.tuning",
    }
    of_the_project = ("benchmarks", "tests", "web")
    users = {name for name in commands() if not name.startswith(of_the_project)}
    assert users == READERS.keys() | only_written


@pytest.mark.parametrize(
    ("command", "line"),
    [
        ("agents.study", "direct-ppo --runs study --seeds 0 --resume"),
        ("train", "--resume run"),
    ],
)
def test_an_option_says_what_is_trusted(command, line, hostile, monkeypatch):
    def train_here(jobs, *_):
        return {job: train_job(job) for job in jobs}

    monkeypatch.setattr("agents.study.train_all", train_here)
    main = main_of(command)
    with suppress(BaseException):
        main(line.split())
    assert Path(MARK).exists()
