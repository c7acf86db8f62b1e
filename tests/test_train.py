import dataclasses
import json
import os
import subprocess
import sys
import threading
from unittest.mock import Mock

import pytest

import train
from agents.training.presets import ENV_PRESETS, PRESETS
from tests import ROOT

REFUSED = {"--seed 6": "--seed must stay 5 with --resume, got 6; only --total-steps may be changed"}
REFUSED["--row direct-ppo"] = "--row must not be given with --resume, got 'direct-ppo'"
REFUSED["--n-epochs 3"] = "Unrecognized options: --n-epochs, 3"


def test_another_environment_has_settings_of_its_own():
    for env, tuned in ENV_PRESETS.items():
        options = train.read_args(["--env", env])
        assert options.hyperparameters == tuned and (options.env, options.action_mode) == (
            env,
            "direct",
        )
        for algo, action_mode in (("sac", "direct"), ("ppo", "residual")):
            config = train.read_args(
                ["--env", env, "--algo", algo, "--task", action_mode]
            ).hyperparameters
            assert config.env_kwargs()["task"] == tuned.env_kwargs()["task"]
            assert (config.action_mode, config.algo, config.energy_weight) == (
                action_mode,
                algo,
                0.0,
            )
            assert ("_pulses" in str(config.controller)) is (action_mode == "residual")


@pytest.mark.parametrize(
    ("text", "value"), [("7", 7), ("8e6", 8_000_000), ("8_000", 8000), ("0", 0)]
)
def test_counts_are_written_in_several_ways(text, value):
    assert train.read_args(["--seed", text]).hyperparameters.seed == value


def started(folder, action_mode, algo, **changes):
    config = dataclasses.replace(PRESETS[action_mode, algo], **changes).to_dict()
    folder.mkdir()
    (folder / "config.json").write_text(
        json.dumps({"task": action_mode, "algo": algo, "hyperparameters": config})
    )
    return folder


@pytest.fixture
def run(tmp_path):
    """The folder of a run that has started."""
    return started(
        tmp_path / "run", "direct", "sac", seed=5, total_steps=1000, observe_parameters=True
    )


def test_resume_takes_everything_from_the_run_but_its_length(run):
    before = train.read_args(["--resume", str(run)])
    assert (before.action_mode, before.algo) == ("direct", "sac")
    assert (before.hyperparameters.seed, before.hyperparameters.total_steps) == (5, 1000)
    longer = train.read_args(["--resume", str(run), "--total-steps", "2e3"])
    assert longer.hyperparameters == dataclasses.replace(before.hyperparameters, total_steps=2000)


@pytest.mark.parametrize(("name", "code"), [("controller", "os:abort"), ("wrapper", ("os:abort",))])
def test_resume_asks_before_it_runs_code_from_elsewhere(name, code, tmp_path, refused):
    folder = started(tmp_path / "run", "residual", "ppo", **{name: code})
    error = refused(train.read_args, ["--resume", str(folder)])
    assert f"{folder / 'config.json'} names code to import, {code!r}: --trust-controller" in error
    options = train.read_args(["--resume", str(folder), "--trust-controller"])
    assert getattr(options.hyperparameters, name) == code


@pytest.mark.parametrize(("words", "message"), REFUSED.items())
def test_resume_refuses_other_changes(run, words, message, refused):
    error = refused(train.main, ["--resume", str(run), *words.split()])
    assert message in error and "Traceback" not in error


def test_a_run_is_never_overwritten(tmp_path, capsys):
    (tmp_path / "config.json").write_text("{}")
    assert train.main(["--run", str(tmp_path)]) == 2 and "--resume" in capsys.readouterr().err


NAMES = {
    "": "residual-ppo",
    "--row direct-ppo": "direct-ppo",
    "--env CapsuleGoal-v0": "goal-direct-ppo",
}
NAMES |= dict.fromkeys(("--controller my:law", "--wrapper my:Wrapper"), "residual-ppo")


@pytest.mark.parametrize(("words", "name"), NAMES.items())
def test_runs_that_begin_at_once_have_folders_of_their_own(
    words, name, tmp_path, monkeypatch, capsys
):
    runs = []
    monkeypatch.setattr(train, "RUNS", tmp_path)
    monkeypatch.setattr(
        "agents.training.loop.begin", lambda run, config: runs.append((run, config.seed))
    )
    monkeypatch.setattr("agents.training.loop.train", lambda *_, **__: False)
    for _ in range(2):
        assert train.main([*words.split(), "--seed", "3", "--no-comparison"]) == 130
    assert (
        len(set(runs)) == 2
        and {run.parent for run, _ in runs} == {tmp_path}
        and {seed for _, seed in runs} == {3}
    )
    assert all(run.name.startswith(f"{name}-seed3-2") for run, _ in runs)
    trust = " --trust-controller" * ("my:" in words)
    assert (
        f"saved. To resume: python train.py --resume {runs[1][0]}{trust}\n"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("error", "said"), [(OSError("full"), ""), (ValueError("odd"), "ValueError: odd")]
)
def test_a_thread_says_what_is_no_error_of_the_system(error, said, capsys):
    train._report(threading.ExceptHookArgs((type(error), error, None, None)))
    assert "".join(capsys.readouterr().err.splitlines()[-1:]) == said


TINY = "--total-steps 64 --num-envs 8 --n-steps 8 --batch-size 32 --hidden 4 --evaluation-episodes 1".split()


def test_a_comparison_that_cannot_be_drawn_is_left_out_before_the_training(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(train, "new_figure", Mock(side_effect=OSError("No space left on device")))
    before, run = threading.excepthook, tmp_path / "run"
    assert train.main([*TINY, "--run", str(run)]) == 0
    said = (
        "Without a comparison at the end, since figures cannot be drawn: No space left on device\n"
    )
    out, err = capsys.readouterr()
    assert (
        err == said
        and f"Training PPO on CapsuleStickSlip-v0, residual torque, seed 0, in {run}.\n" in out
    )
    assert out.endswith(
        f"Trained; the best policy on validation plants is {run / 'best' / 'policy.safetensors'}.\n"
    )
    assert train.QUIET_EXIT.message == f"Stopped. To resume: python train.py --resume {run}"
    assert threading.excepthook is before and not (run / "comparison.png").exists()


def test_an_inherited_environment_keeps_no_command_from_its_work(tmp_path):
    inherited = {
        "MPLBACKEND": "module://no_such_module",
        "PYTHONIOENCODING": "ascii",
        "LC_ALL": "xx_YY.UTF-8",
    }
    kept = {name: os.environ[name] for name in ("PATH", "SYSTEMROOT") if name in os.environ}
    words = [sys.executable, "train.py", *TINY, "--no-comparison", "--run", str(tmp_path / "µ")]
    for command in (words, [sys.executable, "-c", "import train; assert train._can_draw()"]):
        done = subprocess.run(
            command, cwd=ROOT, env={**inherited, **kept}, capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")


def test_a_signal_before_the_training_ends_the_process_at_once():
    code = "import signal; from agents.training.signals import QuietExit; QuietExit().install()"
    for name in ("SIGINT", "SIGTERM"):
        command = [
            sys.executable,
            "-c",
            f"{code}; print(1); signal.raise_signal(signal.{name}); print(2)",
        ]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (130, "1\n", "\nStopped.\n")
