"""The shape of the repository: which module may import which, what an import costs, what may be committed."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ORDER = [
    "files",
    "command_line",
    "compilation",
    "trigonometry",
    "parameters",
    "dynamics",
    "controller",
    "task",
    "kernels",
    "options",
    "simulation",
    "canvas",
    "rendering",
    "env",
    "vector_env",
    "__init__",
]
CAPSULE_GYM = sorted((ROOT / "capsule_gym").rglob("*.py"))
BASELINES = sorted((ROOT / "baselines").rglob("*.py"))
SIZE_LIMIT = 5_000_000
# Put together here, so that this file does not hold them itself.
MACHINE_PATHS = ["/work/" + "main", "/ro" + "ot/"]


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def imports(path: Path, *, at_import_only: bool = False) -> Iterator[str]:
    """Dotted names that a file imports; `from a import b` gives "a.b", whether b is a module or not."""
    package = ".".join(path.relative_to(ROOT).parent.parts)
    pending: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while pending:
        node = pending.pop()
        if at_import_only and (isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or is_type_checking(node)):
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*parents, *([node.module] if node.module else [])])
            yield from (f"{source}.{alias.name}" for alias in node.names)
        pending.extend(ast.iter_child_nodes(node))


def roots(path: Path, *, at_import_only: bool = False) -> set[str]:
    return {name.partition(".")[0] for name in imports(path, at_import_only=at_import_only)}


def layer(path: Path) -> str:
    """The module's place in ORDER; a module of a subpackage counts as that subpackage."""
    return path.relative_to(ROOT / "capsule_gym").with_suffix("").parts[0]


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", CAPSULE_GYM, ids=name_of)
def test_capsule_gym_imports_nothing_to_its_right(path: Path) -> None:
    assert not roots(path) & {"baselines", "agents", "benchmarks", "tests", "train"}
    assert not roots(path, at_import_only=True) & {"torch", "stable_baselines3", "pygame", "matplotlib", "scipy"}


@pytest.mark.parametrize("path", CAPSULE_GYM, ids=name_of)
def test_modules_of_capsule_gym_stand_in_order(path: Path) -> None:
    own = layer(path)
    assert own in ORDER, f"add capsule_gym/{own} to ORDER in {Path(__file__).name}, where its imports allow it"
    used = {name.split(".")[1] for name in imports(path) if name.startswith("capsule_gym.")}
    # A name that is no module comes from the package itself, which imports everything.
    used = {name if (ROOT / "capsule_gym" / name).is_dir() or name in ORDER else "__init__" for name in used} - {own}
    to_the_right = {name for name in used if ORDER.index(name) > ORDER.index(own)}
    assert not to_the_right, f"capsule_gym/{own} may import only what stands before it in ORDER"


@pytest.mark.parametrize("path", BASELINES, ids=name_of)
def test_baselines_import_nothing_to_their_right(path: Path) -> None:
    assert not roots(path) & {"agents", "benchmarks", "tests", "train", "torch", "stable_baselines3"}


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
