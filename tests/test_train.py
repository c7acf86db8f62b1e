import dataclasses
import json
import os
import re
import subprocess
import sys
import threading
from unittest.mock import Mock

import pytest

import train
from agents.training.presets import ENV_PRESETS, PRESETS
from capsule_gym.envs.config import DOCS
from tests import ROOT


@pytest.mark.parametrize(("env", "tuned"), ENV_PRESETS.items())
def test_another_environment_has_settings_of_its_own(env, tuned):
    options = train.read_args(["--env", env])
    assert options.hyperparameters == tuned
    assert options.env == env
    assert options.action_mode == "direct"


@pytest.mark.parametrize("env", ENV_PRESETS)
@pytest.mark.parametrize(
    ("algo", "action_mode", "pulses"), [("sac", "direct", False), ("ppo", "residual", True)]
)
def test_another_environment_has_every_algorithm(env, algo, action_mode, pulses):
    config = train.read_args(["--env", env, "--algo", algo, "--task", action_mode]).hyperparameters
    assert config.env_kwargs()["task"] == ENV_PRESETS[env].env_kwargs()["task"]
    assert config.action_mode == action_mode
    assert config.algo == algo
    assert config.energy_weight == 0.0
    assert config.randomization == ENV_PRESETS[env].randomization
    assert config.termination_penalty == ENV_PRESETS[env].termination_penalty
    assert ("_pulses" in str(config.controller)) is pulses


def test_the_help_describes_options_of_the_environment_as_the_environment_does(capsys):
    with pytest.raises(SystemExit):
        train.main(["--help"])
    shown = " ".join(re.sub("[│╭╮╰╯─]", "", capsys.readouterr().out).split())
    for name in ("energy_weight", "observe_estimates", "stack_size", "initial_range"):
        first, *others = DOCS[name]
        assert f"{first.upper()}{''.join(others)}." in shown


@pytest.mark.parametrize(
    ("text", "value"), [("7", 7), ("8e6", 8_000_000), ("8_000", 8000), ("0", 0)]
)
def test_counts_are_written_in_several_ways(text, value):
    assert train.read_args(["--seed", text]).hyperparameters.seed == value


def started(folder, action_mode, algo, **changes):
    """The folder of a run that has started."""
    config = dataclasses.replace(PRESETS[action_mode, algo], **changes).to_dict()
    folder.mkdir()
    text = json.dumps({"task": action_mode, "algo": algo, "hyperparameters": config})
    (folder / "config.json").write_text(text)
    return folder


@pytest.fixture
def run(tmp_path):
    changes = {"seed": 5, "total_steps": 1000, "observe_parameters": True}
    return started(tmp_path / "run", "direct", "sac", **changes)


def test_resume_takes_everything_from_the_run(run):
    options = train.read_args(["--resume", str(run)])
    assert options.action_mode == "direct"
    assert options.algo == "sac"
    assert options.hyperparameters.seed == 5
    assert options.hyperparameters.total_steps == 1000


def test_resume_can_change_the_length_of_the_run(run):
    before = train.read_args(["--resume", str(run)]).hyperparameters
    longer = train.read_args(["--resume", str(run), "--total-steps", "2e3"]).hyperparameters
    assert longer == dataclasses.replace(before, total_steps=2000)


@pytest.mark.parametrize(("name", "code"), [("controller", "os:abort"), ("wrapper", ("os:abort",))])
def test_resume_asks_before_it_runs_code_from_elsewhere(name, code, tmp_path, refused):
    folder = started(tmp_path / "run", "residual", "ppo", **{name: code})
    error = refused(train.read_args, ["--resume", str(folder)])
    assert f"{folder / 'config.json'} names code to import, {code!r}: --trust-controller" in error
    options = train.read_args(["--resume", str(folder), "--trust-controller"])
    assert getattr(options.hyperparameters, name) == code


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--seed 6", "--seed must stay 5 with --resume, got 6; only --total-steps may be changed"),
        ("--row direct-ppo", "--row must not be given with --resume, got 'direct-ppo'"),
        ("--algo ppo", "--algo must stay sac with --resume, got ppo"),
        ("--n-epochs 3", "Unrecognized options: --n-epochs, 3"),
    ],
)
def test_resume_refuses_other_changes(run, words, message, refused):
    error = refused(train.main, ["--resume", str(run), *words.split()])
    assert message in error
    assert "Traceback" not in error


def test_a_run_is_never_overwritten(tmp_path, capsys):
    (tmp_path / "config.json").write_text("{}")
    assert train.main(["--run", str(tmp_path)]) == 2
    assert "--resume" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("", "residual-ppo"),
        ("--row direct-ppo", "direct-ppo"),
        ("--env CapsuleGoal-v0", "goal-direct-ppo"),
        ("--controller my:law", "residual-ppo"),
        ("--wrapper my:Wrapper", "residual-ppo"),
        ("--wandb", "residual-ppo"),
    ],
)
def test_runs_that_begin_at_once_have_folders_of_their_own(
    words, name, tmp_path, monkeypatch, capsys
):
    begin = Mock()
    trained = Mock(return_value=False)
    monkeypatch.setattr(train, "RUNS", tmp_path)
    monkeypatch.setattr(train, "find_spec", Mock())
    monkeypatch.setattr("agents.training.loop.begin", begin)
    monkeypatch.setattr("agents.training.loop.train", trained)
    for _ in range(2):
        assert train.main([*words.split(), "--seed", "3", "--no-comparison"]) == 130
    runs = [call.args[0] for call in begin.call_args_list]
    assert runs[0] != runs[1]
    for run, config in (call.args for call in begin.call_args_list):
        assert run.parent == tmp_path
        assert run.name.startswith(f"{name}-seed3-2")
        assert config.seed == 3
    assert trained.call_args.kwargs == {"wandb": words == "--wandb"}
    trust = " --trust-controller" if "my:" in words else ""
    hint = f"saved. To resume: python train.py --resume {runs[1]}{trust}\n"
    assert hint in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "said"), [(OSError("full"), ""), (ValueError("odd"), "ValueError: odd")]
)
def test_a_thread_says_what_is_no_error_of_the_system(error, said, capsys):
    train._report(threading.ExceptHookArgs((type(error), error, None, None)))
    assert "".join(capsys.readouterr().err.splitlines()[-1:]) == said


TINY = "--total-steps 64 --num-envs 8 --n-steps 8 --batch-size 32 --hidden 4".split()
TINY += ["--evaluation-episodes", "1"]


def test_a_comparison_that_cannot_be_drawn_is_left_out_before_the_training(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(train, "new_figure", Mock(side_effect=OSError("No space left on device")))
    before = threading.excepthook
    run = tmp_path / "run"
    assert train.main([*TINY, "--run", str(run)]) == 0
    out, err = capsys.readouterr()
    reason = "figures cannot be drawn: No space left on device"
    assert err == f"Without a comparison at the end, since {reason}\n"
    assert f"Training PPO on CapsuleStickSlip-v0, residual torque, seed 0, in {run}.\n" in out
    best = run / "best" / "policy.safetensors"
    assert f"Trained; the best policy on validation plants is {best}.\n" in out
    export = f"python -m capsule_gym.export {run} --c policy.h --law"
    assert out.endswith(f"For a microcontroller: {export}\n")
    assert train.QUIET_EXIT.message == f"Stopped. To resume: python train.py --resume {run}"
    assert threading.excepthook is before
    assert not (run / "comparison.png").exists()


def test_a_complete_run_is_compared(tmp_path, monkeypatch):
    message = []

    def compare(run):
        assert run == tmp_path / "run"
        message.append(train.QUIET_EXIT.message)

    monkeypatch.setattr("agents.training.loop.begin", Mock())
    monkeypatch.setattr("agents.training.loop.train", Mock(return_value=True))
    monkeypatch.setattr("agents.report.compare", compare)
    assert train.main(["--run", str(tmp_path / "run")]) == 0
    assert message == ["Stopped. The run is complete; its comparison is not."]


def test_an_error_of_the_system_in_a_thread_of_the_training_prints_nothing(
    tmp_path, monkeypatch, capsys
):
    def full_disk():
        raise OSError("No space left on device")

    def trained(*_, **__):
        thread = threading.Thread(target=full_disk)
        thread.start()
        thread.join()
        return False

    monkeypatch.setattr("agents.training.loop.begin", Mock())
    monkeypatch.setattr("agents.training.loop.train", trained)
    assert train.main(["--run", str(tmp_path / "run"), "--no-comparison"]) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "words",
    [
        ["train.py", *TINY, "--no-comparison", "--run"],
        ["-c", "import train; assert train._can_draw()"],
    ],
)
def test_an_inherited_environment_keeps_no_command_from_its_work(words, tmp_path):
    inherited = {
        "MPLBACKEND": "module://no_such_module",
        "PYTHONIOENCODING": "ascii",
        "LC_ALL": "xx_YY.UTF-8",
    }
    kept = {name: os.environ[name] for name in ("PATH", "SYSTEMROOT") if name in os.environ}
    command = [sys.executable, *words, str(tmp_path / "µ")]
    done = subprocess.run(command, cwd=ROOT, env=inherited | kept, capture_output=True, text=True)
    assert done.stderr == ""
    assert done.returncode == 0


def test_code_of_the_current_folder_is_found(tmp_path):
    (tmp_path / "mine.py").write_text("found = dict\n")
    command = [sys.executable, str(ROOT / "train.py"), "--wrapper", "mine:found", "--run", "run"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "not a subclass of gymnasium.Wrapper" in done.stderr


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_before_the_training_ends_the_process_at_once(name, tmp_path):
    code = f"import signal; print(1); signal.raise_signal(signal.{name}); print(2)"
    (tmp_path / "mine.py").write_text(code)
    command = [sys.executable, str(ROOT / "train.py"), "--wrapper", "mine:found", "--run", "run"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert done.stdout == "1\n"
    assert done.stderr == "\nStopped.\n"
