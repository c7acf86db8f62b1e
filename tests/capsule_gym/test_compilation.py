"""Compiled code: fingerprints, the disk cache, how a law enters the kernel, and what compiled code may be given."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

from capsule_gym import Capsule, dynamics, elementary, kernels, layout, observation, task
from capsule_gym.compilation import OPTIONS, compile_cached, fingerprint, kernel
from capsule_gym.layout import StepSettings, pack, unpack
from tests.capsule_gym.fakes import helper, make_law

PLANT = Capsule().plant()


@pytest.mark.parametrize(
    ("module", "name"),
    [
        *((elementary, name) for name in ("TURN", "S_3", "C_7")),
        *((dynamics, name) for name in ("EVENT_TOLERANCE", "EVENT_LIMIT")),
        *((task, name) for name in ("THETA_LIMIT", "RATE_LIMIT")),
        *((observation, name) for name in ("THETA_DOT_BOUND", "X_DOT_BOUND")),
        *((kernels, name) for name in ("LANES", "HALTED", "LAW", "PIVOT_TORQUE_ON_CONTACT")),
    ],
)
def test_an_edit_of_a_constant_changes_the_fingerprint_of_the_kernel(module, name, monkeypatch):
    before = fingerprint(kernels.advance)
    monkeypatch.setattr(module, name, getattr(module, name) * 1.0000001 + 1e-300)
    assert fingerprint(kernels.advance) != before


def test_an_edit_of_the_layout_changes_the_fingerprint_of_the_kernel(monkeypatch):
    before = fingerprint(kernels.advance)
    with monkeypatch.context() as patch:
        patch.setattr(kernels, "AT", layout.AT._replace(mu=1 + layout.AT.mu))
        assert fingerprint(kernels.advance) != before
    # The code holds the names of the fields; numba learns their order and types from the class.
    first, second, *rest = StepSettings.__annotations__.items()
    for fields in ([second, first, *rest], [(first[0], complex), second, *rest]):
        monkeypatch.setattr(kernels, "StepSettings", NamedTuple("StepSettings", fields))
        assert fingerprint(kernels.advance) != before


# The values of functions out of one factory, and how many came from the disk.
SCRIPT = """
import sys
import numba
from capsule_gym.compilation import distinct, fingerprint, inner, kernel

def make(gain):
    @numba.njit
    def helper(value):
        return FACTOR * gain * value

    def law(value):
        return helper(value)

    digest = fingerprint(law)[:16]
    return kernel(entry, digest, {"bound": inner(distinct(law, digest))})

def entry(value):
    return bound(value)

values, hits = [], 0
for gain in map(float, sys.argv[1:]):
    function = make(gain)
    function.compile((numba.float64,))
    values.append(function(0.5))
    hits += sum(function.stats.cache_hits.values())
print(values, hits)
"""


def test_the_disk_cache_serves_other_processes_and_never_another_law(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    script = tmp_path / "script.py"

    def run(*gains: float, factor: float = 1.0) -> str:
        # The same size and the same date: nothing of the file but its content tells of an edit.
        script.write_text(SCRIPT.replace("FACTOR", str(factor)))
        os.utime(script, (1e9, 1e9))
        command = [sys.executable, str(script), *map(str, gains)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    assert run(0.5) == "[0.25] 0"
    # numba's counter stands at the same number as in the process before.
    assert run(0.25) == "[0.125] 0"
    assert run(0.5, 0.25) == "[0.25, 0.125] 2"
    assert run(0.5, factor=3.0) == "[0.75] 0"
    assert run(0.5) == "[0.25] 1"


def shifted(x: float) -> float:
    return x + 0.125


def compiled() -> tuple[float, bool]:
    """The function's value at 1, and whether it came from the disk."""
    function = kernel(shifted, fingerprint(shifted), {}, "a function")
    return function(1.0), bool(function.stats.cache_hits)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)


def garble(path: Path) -> None:
    path.write_bytes(random.Random(0).randbytes(path.stat().st_size))


def occupy(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("damage", [truncate, flip, garble, Path.unlink, occupy])
def test_a_damaged_cache_is_compiled_again(tmp_path, monkeypatch, capsys, damage):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert compiled() == (1.125, False)
    assert compiled() == (1.125, True)
    (entry,) = tmp_path.rglob("*.nbc")
    damage(entry)
    assert compiled() == (1.125, False)
    # Repaired, where it can be.
    assert compiled() == (1.125, damage is not occupy)
    assert capsys.readouterr().err.count("compiling a function") == (3 if damage is occupy else 2)


def test_where_no_cache_can_be_written_to_everything_is_compiled(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])
    assert compiled() == compiled() == (1.125, False)


def test_a_law_is_compiled_once_and_no_two_laws_share_a_symbol(monkeypatch):
    monkeypatch.setattr(CPUDispatcher, "compile", lambda *arguments: None)

    def build(gain, memory_size=1, reference_size=2):
        return kernels.build(make_law(gain, numba.njit(helper)), memory_size, reference_size)

    one = build(0.71)
    others = build(0.72), build(0.71, memory_size=2), build(0.71, reference_size=3)
    assert build(0.71) is one
    assert len({id(law) for law in (one, *others)}) == 4

    # Symbols hold the name and a counter of the process: of two equal ones the linker would use the first.
    def names(law):
        own = law.py_func.__globals__["law"].py_func
        inner = next(c.cell_contents for c in own.__closure__ if hasattr(c.cell_contents, "py_func")).py_func
        return {law.py_func.__name__, own.__name__, own.__qualname__, inner.__name__, inner.__qualname__}

    assert not names(one) & names(others[0])


def three_from(array: np.ndarray, start: int) -> tuple[float, ...]:
    return layout.load(array, start, 2, 3)


def two_to(array: np.ndarray, start: int) -> None:
    layout.store(array, start, 1, (1.0, 2.0))


def settings_at(array: np.ndarray, start: int) -> StepSettings:
    return layout.record(array, start, StepSettings)


@pytest.mark.parametrize(
    ("function", "last"), [(three_from, 7), (two_to, 10), (settings_at, 12 - len(StepSettings._fields))]
)
def test_numbas_boundscheck_reaches_what_is_read_and_written_by_offset(function, last, monkeypatch):
    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 1)
    compiled = numba.njit(function, **OPTIONS)
    compiled(np.zeros(12), last)
    for start in (last + 1, -1):
        with pytest.raises(IndexError):
            compiled(np.zeros(12), start)


def test_checked_code_has_its_own_place_in_the_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    for boundscheck in (None, 1, None):
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", boundscheck)
        assert compile_cached.__wrapped__(three_from)(np.arange(12.0), 1) == (1.0, 3.0, 5.0)
    assert len(list(tmp_path.rglob("*.nbc"))) == 2


def test_plant_and_settings_survive_packing():
    settings = StepSettings(1.5, 3.0, 1e-3, 7, 20, 0.1, 10.0, True, False, 2)
    fixed = pack(PLANT, settings, np.zeros((3, 2)))
    assert numba.njit(unpack)(fixed, PLANT.pivot_torque_on_contact) == (PLANT, settings)
    # numpy makes objects of integers that fit none of its types: to the kernel these would be addresses.
    fixed = pack(PLANT, settings._replace(physics_steps=10**300), np.zeros((3, 2), np.float32))
    assert fixed.dtype == np.float64 and fixed.shape == (layout.CONSTANTS + 6,)
