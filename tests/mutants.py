"""Measures how many random faults the tests find: `python -m tests.mutants --count 150 --seed 0`.

A mutant changes one operator, constant or comparison of Python, or removes one statement, in a clone of the last
commit. A mutant is killed if a test fails. The tests of its module run first, then those of its folder, and with
`--whole` all tests.
"""

from __future__ import annotations

import ast
import copy
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

from capsule_gym.command_line import Count, parse

ROOT = Path(__file__).resolve().parents[1]
AGENTS = ("training", "evaluation", "leaderboard")
FOLDERS = ("capsule_gym", "baselines/laws", *(f"agents/{name}" for name in AGENTS))
SWAPS: dict[type, type] = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult},
    **{ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
}


@dataclass(frozen=True)
class Args:
    """Measures how many random faults the tests find.

    Examples:
      python -m tests.mutants --count 150 --jobs 2
      python -m tests.mutants --whole
    """

    count: Count = 150
    """Mutants."""
    seed: int = 0
    """Of their draw."""
    first: int = 0
    """Number of the first mutant of the draw to run."""
    jobs: Count = 1
    """Mutants that run side by side."""
    whole: bool = False
    """Run all tests on a mutant that survives those of its folder."""
    seconds: float = 1800.0
    """Time limit of one run of tests; a mutant that exceeds it is killed."""


@dataclass(frozen=True)
class Mutant:
    """A changed place of a file: its bytes from `start` to `stop`, and the text that replaces them."""

    path: str
    line: int
    start: int
    stop: int
    before: str
    after: str


def mutate(node: ast.AST) -> str | None:
    """The text of a changed copy of a node; None if there is nothing to change."""
    other: Any = copy.deepcopy(node)
    match other:
        case ast.Constant(value=bool(value)):
            return str(not value)
        case ast.Constant(value=int() | float() as value):
            return repr(value + 1 if isinstance(value, int) else 2.0 * value or 1.0)
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in SWAPS:
            other.op = SWAPS[type(op)]()
        case ast.Compare(ops=[op]) if type(op) in SWAPS:
            other.ops = [SWAPS[type(op)]()]
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            return f"({ast.unparse(operand)})"
        case ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Expr(value=ast.Call()):
            return "pass"
        case _:
            return None
    return f"({ast.unparse(other)})"


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a tree that are executed: no annotations, no texts, no imports."""
    if isinstance(node, (ast.JoinedStr, ast.Import, ast.ImportFrom)):
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from walk(child)


def find_mutants(root: Path) -> Iterator[Mutant]:
    """Every mutant of a clone."""
    files = {file for folder in FOLDERS for file in (root / folder).rglob("*.py")}
    for file in sorted(files - {root / "capsule_gym/core/backend.py"}):
        source = file.read_bytes()
        starts = [0]
        for line in source.splitlines(keepends=True):
            starts.append(starts[-1] + len(line))
        for node in walk(ast.parse(source)):
            after = mutate(node)
            if after is not None and isinstance(node, (ast.expr, ast.stmt)):
                start = starts[node.lineno - 1] + node.col_offset
                stop = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
                before = " ".join(source[start:stop].decode().split())
                yield Mutant(str(file.relative_to(root)), node.lineno, start, stop, before, after)


def passes(clone: Path, tests: list[Path], seconds: float) -> bool:
    """Whether the tests pass in time.

    Raises:
        FileNotFoundError: if there are no tests.
    """
    command = [clone / ".venv/bin/python", "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *map(str, tests)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    # A test that ends its process group must not end this command.
    process = subprocess.Popen(
        command, cwd=clone, env=environment, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT
    )
    try:
        code = process.wait(seconds)
        if code == pytest.ExitCode.NO_TESTS_COLLECTED:
            raise FileNotFoundError(f"no tests in {tests}")
        return code == pytest.ExitCode.OK
    except subprocess.TimeoutExpired:
        return False
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def find_killer(mutant: Mutant, clone: Path, args: Args) -> str:
    """The tests that kill a mutant: "module", "folder", "whole", or "" if it survives."""
    folder = clone / "tests" / Path(mutant.path).parent
    tests = {
        "module": sorted(folder.glob(f"test_{Path(mutant.path).stem}*.py")),
        "folder": [folder],
        "whole": [clone / "tests"] if args.whole else [],
    }
    file = clone / mutant.path
    source = file.read_bytes()
    file.write_bytes(source[: mutant.start] + mutant.after.encode() + source[mutant.stop :])
    try:
        return next((name for name, files in tests.items() if files and not passes(clone, files, args.seconds)), "")
    finally:
        file.write_bytes(source)


def main() -> int:
    """Runs the command; its status is 1 if less than nine tenths of the mutants are killed."""
    args = parse(Args, "python -m tests.mutants")
    killers: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(args.jobs) as pool:
        clones: SimpleQueue[Path] = SimpleQueue()
        for job in range(args.jobs):
            subprocess.run(["git", "clone", "-q", ROOT, f"{folder}/{job}"], check=True)
            # An editable installation imports its own packages, wherever it runs.
            subprocess.run(["make", "-s", "-C", f"{folder}/{job}", "venv", f"PYTHON={sys.executable}"], check=True)
            clones.put(Path(folder, str(job)))
        drawn = random.Random(args.seed).sample(list(find_mutants(Path(folder, "0"))), args.count)[args.first :]

        def run(mutant: Mutant) -> None:
            clone, start = clones.get(), time.monotonic()
            try:
                killer = find_killer(mutant, clone, args)
            finally:
                clones.put(clone)
            killers[killer] += 1
            change = f"{mutant.path}:{mutant.line}: {mutant.before[:60]} -> {mutant.after[:60]}"
            print(f"{killer or 'SURVIVED':8s} {time.monotonic() - start:5.0f} s  {change}", flush=True)

        list(pool.map(run, drawn))
    killed = len(drawn) - killers[""]
    print(f"{killed} of {len(drawn)} mutants killed ({killed / len(drawn):.0%}): {dict(killers)}")
    return int(killed < 0.9 * len(drawn))


if __name__ == "__main__":
    sys.exit(main())
