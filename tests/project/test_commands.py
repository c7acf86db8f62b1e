"""Properties of the help of all commands: examples, texts of options and no heavy imports."""

import json
import os
import re
import subprocess
import sys

import pytest

from tests.project.test_pages import ROOT, module_name

HEAVY = {
    "torch",
    "stable_baselines3",
    "sb3_contrib",
    "matplotlib",
    "scipy",
    "numba",
    "joblib",
    "optuna",
    "mujoco",
}
GUARD = '\nif __name__ == "__main__":\n'
# Shows the help of every command in a process of its own, forked after the shared imports.
HELP = """
import contextlib, io, json, os, runpy, sys
import numpy, tyro, gymnasium
sys.path.insert(0, "")
for name in sys.argv[1:]:
    sys.stdout.flush()
    if os.fork() == 0:
        out, code = io.StringIO(), None
        leave, os._exit, sys.argv = os._exit, sys.exit, [name, "--help"]
        with contextlib.redirect_stdout(out):
            try:
                runpy.run_module(name, run_name="__main__", alter_sys=True)
            except SystemExit as stop:
                code = stop.code
        loaded = sorted({each.partition(".")[0] for each in sys.modules})
        print(json.dumps([name, code, out.getvalue(), loaded]))
        sys.stdout.flush()
        leave(0)
    os.wait()
"""


def commands():
    """Every module that can be run, as `python -m` takes it."""
    found = {"train"}
    for package in ("capsule_gym", "baselines", "agents", "benchmarks", "tests", "web"):
        for path in (ROOT / package).rglob("*.py"):
            # The build calls the one of the core.
            if path.name.startswith("test_") or path.parent.name == "core":
                continue
            if GUARD in path.read_text(encoding="utf-8"):
                found.add(module_name(path).removesuffix(".__main__"))
    return sorted(found)


@pytest.fixture(scope="module")
def helps():
    """The command, its status, its help and the libraries that it has loaded, for all commands."""
    if not hasattr(os, "fork"):
        pytest.skip("needs fork")
    call = [sys.executable, "-c", HELP, *commands()]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_every_command_has_a_help(helps):
    assert [(name, status) for name, status, *_ in helps] == [(name, 0) for name in commands()]


def test_help_needs_nothing_heavy(helps):
    for name, *_, loaded in helps:
        assert HEAVY.isdisjoint(loaded), name


def test_help_shows_examples(helps):
    for name, _, text, _ in helps:
        example = "python train.py" if name == "train" else f"python -m {name}"
        assert "Examples:" in text, name
        assert text.count(example) >= 2 or f"{example} " in text, name


def test_every_option_has_a_text(helps):
    for name, _, text, _ in helps:
        words = " ".join(re.sub("[│╭╮╰╯─]", "", text).split())
        assert re.findall(r"(--[a-z-]+)(?: \S+)? \(default: ", words) == [], name
