"""Invalid command lines and missing libraries: the error names the option or the library."""

import importlib
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agents.distillation.__main__ import main as distil
from agents.study import main as study
from baselines.drawing import style
from benchmarks import fresh_draws, identification, rig, sensitivity, throughput, training
from capsule_gym.core import native
from capsule_gym.demo import main as demo
from capsule_gym.evaluation.statistics import estimate
from capsule_gym.export import main as export
from capsule_gym.export.exported import Exported
from capsule_gym.identification.__main__ import main as identify
from train import main as train


@pytest.mark.parametrize(
    ("main", "line", "message"),
    [
        (distil, "nobody", "NAME must be one of .*, got 'nobody'"),
        (study, "", "NAME must be one or several of"),
        (study, "direct-ppo --jobs 0", "--jobs must be an integer >= 1, got 0"),
        (study, "direct-ppo --jobs 2 --backend ray", "--jobs needs --backend loky"),
        (
            study,
            "direct-ppo --backend ray",
            "--backend ray needs Ray: pip install 'capsule-gym",
        ),
        (identification.main, "--plants 0", "--plants: must be an integer >= 1, got '0'"),
        (rig.main, "--plants 0", "--plants: must be an integer >= 1, got '0'"),
        (rig.main, "--total-steps 0", "--total-steps: must be an integer >= 1, got '0'"),
        (sensitivity.main, "--trajectories 0", "--trajectories: must be an integer >= 1, got '0'"),
        (throughput.main, "--turns 0", "--turns: must be an integer >= 1, got '0'"),
        (training.main, "--seeds 0", "--seeds: must be an integer >= 1, got '0'"),
        (
            throughput.main,
            "--figure nowhere/speed",
            "--figure must name a file in a folder that exists, got 'nowhere",
        ),
        (identification.main, "--amplitude nan", r"--amplitude must be .* \(N m\), got nan"),
        (identification.main, "--amplitude 9.0", r"--amplitude must be .* \(N m\), got 9.0"),
        (
            fresh_draws.main,
            "pd lqrr",
            "lqrr: no results in lqrr.npz; `python -m agents.leaderboard NAME` writes",
        ),
        (export, "", "(?i)required|missing"),
        (export, "direct-ppo", "at least one of --c and --onnx must be given"),
        (
            export,
            "direct-ppo --c policy.h --amplitude 0.3",
            "--amplitude is for .excitation. alone",
        ),
        (
            export,
            "excitation --c policy.h --duration -1",
            "seconds must be a finite number >= 0.02",
        ),
        (
            export,
            "direct-ppo --law --c policy.h",
            "as baselines:adaptive, got a policy without a control law",
        ),
        (
            export,
            "tests.capsule_gym.fakes:picky_controller --c policy.h",
            "--law needs a control law of the core",
        ),
        (export, "baselines:adaptive --onnx law.onnx", "--onnx needs a policy"),
        (
            export,
            "direct-ppo --onnx policy.h",
            r"--onnx must be the name of a file \.onnx, got 'policy\.h'",
        ),
        (
            export,
            "direct-ppo --c policy.c",
            "--c must be the name of a file .h, got 'policy.c'",
        ),
        (export, "direct-pqo --c policy.h", "name_or_path must be one of"),
        (demo, "direct-po", r"did you mean 'direct-ppo'\?"),
        (
            demo,
            "goal",
            "policy must be for the task 'speed' of the set 'paper', got 'goal', which is for 'g",
        ),
        (demo, "adaptive --slow", "--slow"),
        (
            demo,
            "adaptive --output film.mp4",
            "--output must be the name of a GIF, got 'film.mp4'",
        ),
        (
            demo,
            "adaptive --output nowhere/film.gif",
            "--output must name a file in a folder that exists",
        ),
        (demo, "adaptive --set papr", r"got 'papr'; did you mean 'paper'\?"),
        (demo, "adaptive --seed 400", "--seed must be one of the set's, 0 to 399, got 400"),
        (demo, "adaptive --speed 0", "--speed must be a number from 0.1 to 20"),
        (demo, "adaptive --seconds 0", "--seconds must be above 0 and at most 33 s, got 0.0"),
        (demo, "adaptive --rival keyboard -o out.gif", "'keyboard' with --output"),
        (
            identify,
            f"{__file__} --report fit",
            r"--report must be the name of a file \.png or \.svg or \.pdf",
        ),
        (identify, "nowhere.csv", "log must be a file, got 'nowhere.csv'"),
        (train, "--total-steps inf", "--total-steps: must be an integer >= 0, got 'inf'"),
        (train, "--seed abc", "--seed: must be an integer >= 0, got 'abc'"),
        (train, "--seed 1.5", "--seed: must be an integer >= 0, got '1.5'"),
        (train, "--seed -3", "--seed: must be an integer >= 0, got '-3'"),
        (train, "--tota 4", "--tota"),
        (train, "--wandb", r'--wandb needs wandb: pip install "capsule-gym\[wandb\]"$'),
        (train, "--resume nowhere", "nowhere"),
        (train, "--row fastest", "--row: a row must be one of residual-ppo, "),
        (
            train,
            "--row direct-ppo --task residual",
            "--task must stay direct with --row direct-ppo,",
        ),
    ],
)
def test_an_invalid_command_line_ends_with_2_and_names_the_option(
    main, line, message, refused, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    for library in ("ray", "wandb"):
        monkeypatch.setitem(sys.modules, library, None)
    said = refused(main, line.split())
    without_frames = re.sub("[│╭╮╰╯─]", "", said)
    assert re.search(message, " ".join(without_frames.split()))
    assert list(tmp_path.iterdir()) == []


def reload_shooting():
    importlib.reload(importlib.import_module("capsule_gym.identification.shooting"))


@pytest.mark.parametrize(
    ("library", "call", "message"),
    [
        ("jinja2", lambda: Exported("direct-ppo").c(), "--c needs jinja2"),
        ("onnx", lambda: Exported("direct-ppo").onnx(), "--onnx needs onnx"),
        ("matplotlib", lambda: style().__enter__(), "figures need matplotlib"),
        ("scipy.linalg", reload_shooting, "identify needs scipy"),
        ("scipy.special", lambda: estimate(np.ones((3, 4))), "intervals need scipy"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(library, call, message, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"^{message}: pip install \"capsule-gym\[\w+\]\"$"):
        call()


@pytest.mark.parametrize(
    ("name", "extra"),
    [
        ("baselines.tuning", "paper"),
        ("capsule_gym.demo", "render"),
        ("capsule_gym.export.__main__", "export"),
        ("capsule_gym.identification.__main__", "identify"),
    ],
)
def test_a_command_without_tyro_names_the_extra_of_all_that_it_needs(name, extra, monkeypatch):
    running = SimpleNamespace(__spec__=SimpleNamespace(name=name))
    monkeypatch.setitem(sys.modules, "tyro", None)
    monkeypatch.setitem(sys.modules, "__main__", running)
    shown = name.removesuffix(".__main__")
    message = rf"^python -m {shown}: error: .* needs tyro: pip install \"capsule-gym\[{extra}\]\"$"
    with pytest.raises(SystemExit, match=message):
        importlib.reload(sys.modules["capsule_gym.command_line"])
    monkeypatch.setattr(running, "__spec__", None)
    with pytest.raises(ImportError, match="needs tyro: pip install"):
        importlib.reload(sys.modules["capsule_gym.command_line"])


def test_sources_that_are_not_compiled_are_named(tmp_path, monkeypatch):
    """A clone in whose folder Python finds them before an installed package."""
    (tmp_path / "sources").mkdir()
    shutil.copy(Path(native.__file__).with_name("__init__.py"), tmp_path / "sources")
    monkeypatch.syspath_prepend(tmp_path)
    message = r"sources contains no compiled core: .* pip install -e \.$"
    with pytest.raises(ImportError, match=message):
        importlib.import_module("sources")
