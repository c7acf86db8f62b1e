"""The shape of the repository: which module may import which, what an import costs, what may be committed."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SIZE_LIMIT = 5_000_000
# Put together here, so that this file does not hold them itself.
MACHINE_PATHS = ["/work/" + "main", "/ro" + "ot/"]
PACKAGES = ("capsule_gym", "baselines", "agents", "web", "benchmarks", "examples", "tests")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def lint_imports(folder: Path) -> str:
    """What import-linter says about the packages in a folder, under the contracts of its pyproject.toml."""
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    command = [sys.executable, "-c", code, "--no-cache", "--no-logo"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (" 0 broken" in done.stdout), done.stdout + done.stderr
    return done.stdout


linted = pytest.mark.skipif(importlib.util.find_spec("importlinter") is None, reason="import-linter needs Python 3.11")


@linted
def test_imports_keep_the_contracts():
    report = lint_imports(ROOT)
    assert " 0 broken" in report, report


@linted
def test_a_wrong_import_breaks_its_contract(tmp_path: Path):
    for name in PACKAGES:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__", "*.zip", "*.npz"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for place, line in {
        "capsule_gym/dynamics.py": "from capsule_gym import task",
        "capsule_gym/task.py": "from capsule_gym import Capsule",
        "capsule_gym/rendering.py": "def plot():\n    import matplotlib",
        "baselines/tables.py": "import torch",
        "baselines/laws/gains.py": "from baselines.gaits import bound",
        "agents/evaluation/sets.py": "import benchmarks.web",
        "agents/training/runs.py": "import agents.comparison",
        "web/fused.py": "import web.modules",
        "examples/sb3_ppo.py": "import agents.evaluation.policies",
    }.items():
        with (tmp_path / place).open("a", encoding="utf-8") as file:
            file.write(f"\n{line}\n")
    assert " 0 kept" in lint_imports(tmp_path)


@pytest.mark.parametrize("module", sorted((ROOT / "capsule_gym").glob("[!_]*.py")), ids=lambda path: path.stem)
def test_every_module_of_capsule_gym_has_a_test_file_of_its_name(module: Path):
    assert (ROOT / "tests" / "capsule_gym" / f"test_{module.name}").is_file()


def test_import_is_light() -> None:
    code = "import sys, capsule_gym; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(result.stdout.split())
    assert "capsule_gym" in loaded
    # Not scipy: numba imports it wherever it is installed.
    assert not loaded & {"torch", "pygame", "matplotlib", "stable_baselines3", "agents", "baselines"}


@pytest.fixture(scope="module")
def tracked() -> list[Path]:
    """Files that are committed, or would be by `git add .`."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [ROOT / name for name in listing.split("\0") if name]
    return [path for path in files if path.is_file()]


def test_no_large_file_is_tracked(tracked: list[Path]) -> None:
    assert tracked
    assert {name_of(path): path.stat().st_size for path in tracked if path.stat().st_size > SIZE_LIMIT} == {}


def test_no_tracked_text_names_a_machine_path(tracked: list[Path]) -> None:
    found = []
    for path in tracked:
        content = path.read_bytes()
        if b"\0" not in content[:8192]:
            found += [(name_of(path), text) for text in MACHINE_PATHS if text.encode() in content]
    assert not found
