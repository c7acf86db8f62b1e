"""Properties of all commands: fast help with examples and without heavy imports, and errors that
name the argument."""

import ast
import json
import os
import re
import subprocess
import sys

import pytest

from tests import ROOT

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
        print(json.dumps([name, code, out.getvalue(), sorted({each.partition(".")[0] for each in sys.modules})]))
        sys.stdout.flush()
        leave(0)
    os.wait()
"""


def commands():
    """Every module that can be run, as `python -m` takes it."""
    found = {"train"}
    for package in ("capsule_gym", "baselines", "agents", "benchmarks", "tests", "web"):
        for path in (ROOT / package).rglob("*.py"):
            guards = (
                node
                for node in ast.parse(path.read_text(encoding="utf-8")).body
                if isinstance(node, ast.If)
            )
            guarded = any(ast.unparse(guard.test) == "__name__ == '__main__'" for guard in guards)
            # The build calls the one of the core.
            if guarded and not path.name.startswith("test_") and path.parent.name != "core":
                found.add(
                    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")
                )
    return sorted(found)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_help_shows_examples_and_needs_nothing_heavy():
    names = commands()
    done = subprocess.run(
        [sys.executable, "-c", HELP, *names], cwd=ROOT, capture_output=True, text=True, check=True
    )
    shown = list(map(json.loads, done.stdout.splitlines()))
    assert [name for name, *_ in shown] == names
    for name, status, text, loaded in shown:
        example = "python train.py" if name == "train" else f"python -m {name}"
        assert status == 0 and "Examples:" in text and not set(loaded) & HEAVY, name
        assert text.count(example) >= 2 or f"{example} " in text, name
        words = " ".join(re.sub("[│╭╮╰╯─]", "", text).split())
        assert re.findall(r"(--[a-z-]+)(?: \S+)? \(default: ", words) == [], (
            f"{name}: options without a text"
        )
