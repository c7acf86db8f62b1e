"""Compiled code: fingerprints, the disk cache, laws in the kernel, and valid arguments."""

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

from capsule_gym import Capsule, compilation, contact, elementary, kernels, layout, observation, task
from capsule_gym.compilation import OPTIONS, compile_entry, fingerprint
from capsule_gym.compiler import compile_cached
from capsule_gym.layout import StepSettings, pack, unpack
from tests.capsule_gym.fakes import helper, make_law

PLANT = Capsule().plant()


@pytest.fixture(autouse=True)
def numbas_variables():
    """Makes numba read its environment variables again after each test."""
    yield
    numba.config.reload_config()


def set_variable(monkeypatch, name: str, value: object) -> None:
    monkeypatch.setenv(name, str(value))
    numba.config.reload_config()


@pytest.mark.parametrize(
    ("module", "name"),
    [
        *((elementary, name) for name in ("TURN", "S_3", "C_7")),
        *((contact, name) for name in ("EVENT_TOLERANCE", "EVENT_LIMIT")),
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
    # The code contains the names of the fields; numba takes their order and types from the class.
    first, second, *rest = StepSettings.__annotations__.items()
    for fields in ([second, first, *rest], [(first[0], complex), second, *rest]):
        monkeypatch.setattr(kernels, "StepSettings", NamedTuple("StepSettings", fields))
        assert fingerprint(kernels.advance) != before


# Prints the values of functions from one factory, and whether numba was imported.
SCRIPT = """
import sys
from capsule_gym.compilation import compile_entry


DEFINITIONS

def entry(value):
    return int(bound(value))

def law_of(gain):
    return compile_entry(entry, "int64(float64)", "a law", {"bound": make(gain)})

print([law_of(float(gain)).call(100.0) for gain in sys.argv[1:]], "numba" in sys.modules)
"""


PLAIN = """
def make(gain):
    factor = FACTOR * gain
    return lambda value: factor * value
"""
JITTED = """
import numba

def make(gain):
    @numba.njit
    def helper(value):
        return FACTOR * gain * value

    return lambda value: helper(value)
"""


@pytest.mark.parametrize("definitions", [PLAIN, JITTED], ids=["plain", "jitted"])
def test_the_disk_cache_serves_other_processes_and_never_another_law(tmp_path, definitions):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    script = tmp_path / "script.py"

    def run(*gains: float, factor: float = 1.0) -> tuple[str, int]:
        # The size and the date stay the same, so that only the content shows an edit.
        script.write_text(SCRIPT.replace("DEFINITIONS", definitions).replace("FACTOR", str(factor)))
        os.utime(script, (1e9, 1e9))
        command = [sys.executable, str(script), *map(str, gains)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.strip(), done.stderr.count("compiling a law")

    assert run(0.5) == ("[50] True", 1)
    assert run(0.25) == ("[25] True", 1)
    # If nothing has to be compiled, numba is not imported.
    jitted = definitions is JITTED
    assert run(0.5, 0.25) == (f"[50, 25] {jitted}", 0)
    assert run(0.5, factor=3.0) == ("[150] True", 1)
    assert run(0.5) == (f"[50] {jitted}", 0)


def shifted(x: float) -> int:
    return int(x + 7.5)


def compiled(monkeypatch) -> int:
    """The function's value at 1, loaded from the disk or compiled."""
    monkeypatch.setattr(compilation, "_loaded", {})
    return compile_entry(shifted, "int64(float64)", "a function").call(1.0)


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
def test_damaged_machine_code_is_compiled_again(tmp_path, monkeypatch, capsys, damage):
    set_variable(monkeypatch, "NUMBA_CACHE_DIR", tmp_path)
    for expected in (1, 0):
        assert compiled(monkeypatch) == 8
        assert capsys.readouterr().err.count("compiling a function") == expected
    (entry,) = tmp_path.rglob("*.o")
    damage(entry)
    # The entry is repaired if possible.
    for expected in (1, damage is occupy):
        assert compiled(monkeypatch) == 8
        assert capsys.readouterr().err.count("compiling a function") == expected


def allocating(x: float) -> tuple[float, int]:
    return x + 0.125, len(np.zeros(3))


@pytest.mark.parametrize("damage", [truncate, flip, garble, Path.unlink, occupy])
def test_a_damaged_file_of_numbas_is_compiled_again(tmp_path, monkeypatch, damage):
    set_variable(monkeypatch, "NUMBA_CACHE_DIR", tmp_path)

    def hits() -> int:
        function = compile_cached.__wrapped__(allocating)
        assert function(1.0) == (1.125, 3)
        return sum(function.stats.cache_hits.values())

    assert (hits(), hits()) == (0, 1)
    (entry,) = tmp_path.rglob("*.nbc")
    damage(entry)
    assert (hits(), hits()) == (0, damage is not occupy)


def test_where_no_cache_can_be_written_to_everything_is_compiled(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    set_variable(monkeypatch, "NUMBA_CACHE_DIR", tmp_path / "file")
    assert compiled(monkeypatch) == compiled(monkeypatch) == 8
    assert capsys.readouterr().err.count("compiling a function") == 2


def wait(seconds: float) -> int:
    return int(seconds)


def test_of_several_processes_one_compiles_and_the_others_wait(tmp_path):
    script = (
        "from tests.capsule_gym.test_compilation import wait, compile_entry\n"
        "print(compile_entry(wait, 'int64(float64)', 'a function').call(3.5))"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    processes = [
        subprocess.Popen([sys.executable, "-c", script], env=environment, stdout=-1, stderr=-1, text=True)
        for _ in range(3)
    ]
    outputs = [process.communicate() for process in processes]
    assert [out for out, _ in outputs] == ["3\n"] * 3
    assert sum("compiling a function" in err for _, err in outputs) == 1


def test_a_law_is_compiled_once(monkeypatch):
    def build(gain, memory_size=1, reference_size=2):
        return kernels.build(make_law(gain, numba.njit(helper)), memory_size, reference_size)

    one = build(0.71)
    others = build(0.72), build(0.71, memory_size=2), build(0.71, reference_size=3)
    assert build(0.71) is one
    assert len({law.address for law in (one, *others)}) == 4


def total_of(array: np.ndarray, scale: float, last: bool) -> int:
    total = 0
    for i in range(array.shape[0]):
        for j in range(array.shape[1]):
            total += int(array[i, j] * scale)
    return -total if last else total


def test_what_python_calls_checks_its_arguments():
    call = compile_entry(total_of, "int64(float32[:, ::1], float64, boolean)").call
    array = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert (call(array, 2.0, False), call(array, 2, True), call(array, np.float32(2), 7)) == (30, -30, -30)
    for wrong in ((array, 2.0), (array[0], 2.0, True), ([[1.0]], 2.0, True), (array, "2", True), (array, 2.0, True, 1)):
        with pytest.raises(TypeError, match="total_of: arguments must be"):
            call(*wrong)


def three_from(array: np.ndarray, start: int) -> tuple[float, ...]:
    return layout.load(array, start, 2, 3)


def two_to(array: np.ndarray, start: int) -> None:
    layout.store(array, start, 1, (1.0, 2.0))


def settings_at(array: np.ndarray, start: int) -> StepSettings:
    return layout.record(array, start, StepSettings)


@pytest.mark.parametrize(
    ("function", "last"), [(three_from, 7), (two_to, 10), (settings_at, 30 - len(StepSettings._fields))]
)
def test_numbas_boundscheck_reaches_what_is_read_and_written_by_offset(function, last, monkeypatch):
    set_variable(monkeypatch, "NUMBA_BOUNDSCHECK", 1)
    compiled = numba.njit(function, **OPTIONS)
    size = 30 if function is settings_at else 12
    compiled(np.zeros(size), last)
    for start in (last + 1, -1):
        with pytest.raises(IndexError):
            compiled(np.zeros(size), start)


def entry_of(array: np.ndarray, n: int) -> int:
    return int(array[n])


def test_checked_code_has_its_own_place_in_the_cache(monkeypatch, tmp_path):
    set_variable(monkeypatch, "NUMBA_CACHE_DIR", tmp_path)
    for boundscheck in (0, 1, 0):
        set_variable(monkeypatch, "NUMBA_BOUNDSCHECK", boundscheck)
        entry = compile_entry(entry_of, "int64(float64[::1], int64)").call
        assert entry(np.arange(12.0), 1) == 1
        if boundscheck:
            with pytest.raises(IndexError, match="entry_of: an index is out of range"):
                entry(np.arange(12.0), 12)
    assert len(list(tmp_path.rglob("*.o"))) == 2


def test_plant_and_settings_survive_packing():
    settings = StepSettings(1.5, 3.0, True, 1e-3, 7, 20, 0.1, 10.0, True, False, 2)
    fixed = pack(PLANT, settings, np.zeros((3, 2)))
    assert numba.njit(unpack)(fixed, PLANT.pivot_torque_on_contact, PLANT.extended) == (PLANT, settings)
    # numpy stores integers that fit none of its types as objects; the kernel would read these as addresses.
    fixed = pack(PLANT, settings._replace(physics_steps=10**300), np.zeros((3, 2), np.float32))
    assert fixed.dtype == np.float64 and fixed.shape == (layout.CONSTANTS + 6,)
