"""What all commands of the benchmarks have in common."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = (
    "accuracy",
    "page",
    "regression",
    "throughput",
    "training",
    "training_speed",
    "web",
)
HEAVY = ("torch", "stable_baselines3", "matplotlib", "mujoco", "envpool", "scipy.integrate", "scipy.optimize")

HELP = """
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(f"benchmarks.{name}").main(["--help"])
    except SystemExit as stop:
        assert stop.code == 0, name
print("loaded:", *sys.modules)
"""


def test_help_runs_nothing_and_needs_none_of_what_is_measured() -> None:
    command = [sys.executable, "-c", HELP, *COMMANDS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    *text, loaded = done.stdout.splitlines()
    for name in COMMANDS:
        assert sum(line.startswith(f"usage: python -m benchmarks.{name} ") for line in text) == 1
    assert not set(HEAVY) & set(loaded.split())


def test_every_module_with_a_command_line_is_listed() -> None:
    ends = "    sys.exit(main())\n"
    found = {path.stem for path in (ROOT / "benchmarks").glob("*.py") if path.read_text("utf-8").endswith(ends)}
    assert found == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_files_that_cannot_be_written_are_refused_before_the_work(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main = importlib.import_module(f"benchmarks.{name}").main
    path = tmp_path / "numbers.json"
    path.write_text("{}", encoding="utf-8")
    for arguments in (
        ["--json", str(path)],
        ["--markdown", str(tmp_path)],
        ["--json", str(tmp_path / "no" / "x.json")],
    ):
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        assert stop.value.code == 2
        assert arguments[0] in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "{}"
