"""The bits of whole episodes on this processor, on a lesser one, and with other libraries of elementary functions."""

from __future__ import annotations

import ast
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import bits

# Two kernels, the network and the compiled rollout, which is what there is time for: `python -m tests.bits --variants`
# takes everything to all processors.
SUBJECTS = ("plant", "law adaptive", "policy residual-ppo/seed-0")
ROOT = Path(__file__).resolve().parents[2]
# What episodes and their numbers depend on; pictures, the search for gaits and the paper's tables are left out.
PICTURES = ("canvas.py", "rendering.py")
MODULES = [
    path.relative_to(ROOT).as_posix()
    for pattern in ("capsule_gym/*.py", "baselines/laws/*.py", "baselines/policies.py", "agents/evaluation/*.py")
    for path in sorted(ROOT.glob(pattern))
    if path.name not in PICTURES
] + [f"baselines/gaits/{name}.py" for name in ("archive", "families", "policy")]
MODULES += [f"baselines/dynamic_programming/{name}.py" for name in ("archive", "grid", "policy", "problem", "solver")]
# Functions whose last digit is the library's, and sums whose order or whose fused products are the processor's.
FOREIGN = set(
    "sin cos tan asin acos atan atan2 arcsin arccos arctan arctan2 sinh cosh tanh arcsinh arccosh arctanh asinh acosh "
    "atanh exp exp2 expm1 log log2 log10 log1p pow power float_power hypot cbrt gamma lgamma erf erfc dist logspace "
    "geomspace interp dot vdot vecdot inner matmul matvec vecmat einsum tensordot linalg fft convolve correlate".split()
)
SAMPLE = """
import hashlib, math, numpy as np
from agents.evaluation.statistics import paired_difference
x = np.linspace(0.1, 9.0, 10_000)
print(paired_difference(x.reshape(5, -1)[:, ::-3], np.sqrt(x).reshape(5, -1)[:, ::-3]))
for values in (np.exp(x), np.array([math.sin(value) for value in x])):
    print(hashlib.sha256(values.tobytes()).hexdigest())
"""


def test_bits_are_the_committed_ones(capsys):
    assert bits.main([]) == 0, capsys.readouterr().out


def test_bits_do_not_depend_on_the_processor():
    if "generic" not in bits.processors():
        pytest.skip("the names of processors are those of x86")
    done = bits.run(bits.processors()["generic"], *SUBJECTS)
    assert done.returncode == 0, done.stdout + done.stderr


def foreign(source: str) -> Iterator[str]:
    """Where a module takes what is not the same everywhere, one line each."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.attr in FOREIGN:
            if node.value.id in ("math", "cmath", "np", "numpy"):
                yield f"line {node.lineno}: {node.value.id}.{node.attr}"
        if isinstance(node, ast.ImportFrom) and node.module in ("math", "cmath", "numpy"):
            yield from (f"line {node.lineno}: {each.name}" for each in node.names if each.name in FOREIGN)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield f"line {node.lineno}: @"
        # A power of two is exact.
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            if not (isinstance(node.left, ast.Constant) and node.left.value == 2):
                yield f"line {node.lineno}: **"


@pytest.mark.parametrize("name", MODULES)
def test_episodes_take_no_functions_of_other_libraries(name):
    assert not list(foreign((ROOT / name).read_text(encoding="utf-8")))


def test_functions_of_other_libraries_are_found():
    source = "from math import tanh\nx = np.sin(y)\nz = math.exp(x)\nw = a @ b\nv = x**2 + 2.0**52\nsin(x)\n"
    assert list(foreign(source)) == ["line 1: tanh", "line 4: @", "line 2: np.sin", "line 3: math.exp", "line 5: **"]


def test_bits_do_not_depend_on_the_libraries_of_elementary_functions():
    done = bits.run(bits.both_libraries())
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc" or not {"fma", "avx2"} <= bits.own_features(),
    reason="elsewhere the C library has nothing to choose from",
)
def test_those_libraries_compute_other_functions_and_the_same_statistics():
    own, other = (
        subprocess.run(
            [sys.executable, "-c", SAMPLE],
            cwd=ROOT,
            env={**os.environ, **variables},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.splitlines()
        for variables in ({}, bits.both_libraries())
    )
    assert own[0] == other[0], "the statistics, in which numpy does nothing but add, sort and divide"
    assert own[1] != other[1], "numpy's exponential"
    assert own[2] != other[2], "the C library's sine"


def test_a_subject_that_has_no_hash_and_a_hash_without_subject_count(capsys, monkeypatch, tmp_path):
    (tmp_path / "bits.json").write_text('{"plant": "0", "law lost": "1"}', encoding="utf-8")
    monkeypatch.setattr(bits, "FILE", tmp_path / "bits.json")
    some = [subject for subject in bits.subjects() if subject.name in ("plant", "law epc")]
    monkeypatch.setattr(bits, "subjects", lambda: some)
    assert bits.main([]) == 1
    out = capsys.readouterr().out
    assert "law lost: is no subject" in out
    assert "plant: " in out and "here, 0 committed" in out
    assert "law epc: " in out and "here, None committed" in out
