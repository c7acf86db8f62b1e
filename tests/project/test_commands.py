"""What every command has in common: help at once, which runs nothing, shows examples and imports nothing heavy."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Started by other commands, and by no user; and by tests.
STARTED = {"web.modules": "web.build"}
INNER = set(STARTED)
HEAVY = {"torch", "stable_baselines3", "sb3_contrib", "matplotlib", "scipy", "numba", "joblib", "optuna", "mujoco"}


def commands() -> list[str]:
    """Every module that can be run, as `python -m` takes it."""
    found = []
    for package in ("capsule_gym", "baselines", "agents", "benchmarks", "tests", "web"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            guards = (node for node in ast.parse(text).body if isinstance(node, ast.If))
            if any(ast.unparse(guard.test) == "__name__ == '__main__'" for guard in guards):
                found.append(".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__"))
    return sorted({*found, "train"} - INNER)


COMMANDS = commands()


@cache
def help_of(name: str) -> tuple[set[str], str]:
    """The packages that a command has imported when it has shown its help, and the help."""
    words = ["train.py"] if name == "train" else ["-m", name]
    command = [sys.executable, "-X", "importtime", *words, "--help"]
    done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    imported = re.findall(r"^import time:.*\|\s*([\w.]+)$", done.stderr, re.MULTILINE)
    return {module.partition(".")[0] for module in imported}, done.stdout


def test_commands_are_found() -> None:
    assert set(COMMANDS) >= {
        "capsule_gym.play",
        "agents.evaluate",
        "baselines.paper",
        "tests.bits",
        "web.build",
        "train",
    }


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples_of_the_command(name: str) -> None:
    _, text = help_of(name)
    assert "Examples:" in text
    shown = "python train.py" if name == "train" else f"python -m {name}"
    assert text.count(shown) >= 2 or f"{shown} " in text


@pytest.mark.parametrize("name", COMMANDS)
def test_help_needs_nothing_heavy(name: str) -> None:
    loaded, _ = help_of(name)
    assert "numpy" in loaded
    assert not loaded & HEAVY


@pytest.mark.parametrize("name", STARTED)
def test_a_part_of_another_command_names_that_command(name: str) -> None:
    for words in ([], ["--help"]):
        command = [sys.executable, "-m", name, *words]
        done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        assert f"python -m {STARTED[name]}," in done.stderr
