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
# Started by other commands and by tests, and by no user.
INNER = {"agents.study.worker", "tests.agents.study.small"}
HEAVY = {"torch", "stable_baselines3", "sb3_contrib", "matplotlib", "scipy", "numba", "joblib", "optuna", "mujoco"}
# Searches and checks of the project itself: what they search or check is compiled when it is imported, and numba brings
# a part of scipy.
COMPILED = {
    "baselines.gaits",
    "baselines.gaits.law_search",
    "baselines.optimum",
    "baselines.paper.optimal_profiles",
    "baselines.paper.sensitivity",
    "benchmarks.regression",
    "benchmarks.tricks",
    "tests.bits",
    "tests.fuzz",
}
# Its subject is trainings, which it sets up as it is imported.
TRAINING = {"tests.faults"}


def commands() -> list[str]:
    """Every module that can be run, as `python -m` takes it."""
    found = []
    for package in ("capsule_gym", "baselines", "agents", "benchmarks", "tests"):
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
    assert {"capsule_gym.play", "capsule_gym.demo", "agents.evaluate", "agents.study", "train"} <= set(COMMANDS)
    assert set(COMMANDS) >= COMPILED | TRAINING


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples_of_the_command(name: str) -> None:
    _, text = help_of(name)
    assert "Examples:" in text
    shown = "python train.py" if name == "train" else f"python -m {name}"
    assert text.count(shown) >= 2 or f"{shown} " in text


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - TRAINING))
def test_help_needs_nothing_heavy(name: str) -> None:
    loaded, _ = help_of(name)
    assert "numpy" in loaded
    allowed = {"numba", "scipy"} if name in COMPILED else set()
    assert not loaded & (HEAVY - allowed)


def test_a_part_of_a_study_is_started_by_the_study() -> None:
    for words in ([], ["--help"]):
        command = [sys.executable, "-m", "agents.study.worker", *words]
        done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
