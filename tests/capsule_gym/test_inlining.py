"""Marks for compiled code: everybody who asks hears of every mark, and plain functions stay plain."""

from __future__ import annotations

import subprocess
import sys

import pytest

from capsule_gym import inlining
from capsule_gym.inlining import inlined, on_marking


@pytest.fixture(autouse=True)
def nothing_marked(monkeypatch):
    """So that no mark of these tests reaches the compiler."""
    monkeypatch.setattr(inlining, "_marked", [])
    monkeypatch.setattr(inlining, "_told", [])


def double(x: float) -> float:
    return 2.0 * x


def half(x: float) -> float:
    return 0.5 * x


def test_a_marked_function_stays_itself():
    assert inlined(double) is double


def test_marks_before_and_after_the_asking_are_told_once_and_in_order():
    early, late = [], []
    on_marking(early.append)
    inlined(double)
    on_marking(late.append)
    inlined(half)
    assert early == late == [double, half]


def test_what_is_marked_before_the_compiler_is_loaded_compiles_after():
    code = """
import sys
from capsule_gym.task import clip
assert "numba" not in sys.modules
import capsule_gym.compilation
from numba import njit
print(njit(lambda x: clip(x, 1.0))(3.0))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "1.0\n", done.stderr
