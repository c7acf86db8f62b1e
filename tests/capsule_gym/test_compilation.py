"""How plain functions become compiled ones: fingerprints, and the disk cache across processes."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import FunctionType, ModuleType
from typing import NamedTuple

import numba
import numpy as np
import pytest

from capsule_gym import Capsule, dynamics, elementary, kernels, layout, observation, task
from capsule_gym.compilation import fingerprint
from tests.capsule_gym.fakes import helper, make_law, other_helper

PLANT = Capsule().plant()


def test_fingerprint_sees_gains_helpers_and_code():
    same = fingerprint(make_law(1.0))
    assert fingerprint(make_law(1.0)) == same
    assert fingerprint(make_law(1.5)) != same
    assert fingerprint(make_law(1.0, other_helper)) != same
    jitted = fingerprint(make_law(1.0, numba.njit(helper)))
    assert fingerprint(make_law(1.0, numba.njit(helper))) == jitted
    assert fingerprint(make_law(1.0, numba.njit(fastmath=True)(helper))) != jitted
    assert fingerprint(make_law(np.array([1.0, 2.0]))) != fingerprint(make_law(np.array([1.0, 2.5])))
    # Far inside an array inside a tuple, where a repr shows dots.
    tables = [np.zeros(2000) for _ in range(2)]
    tables[1][1000] = 1.0
    assert fingerprint(make_law((tables[0], 1.0))) != fingerprint(make_law((tables[1], 1.0)))


def test_fingerprint_follows_globals_and_modules(monkeypatch):
    def law(theta, theta_dot, x, x_dot, memory, reference):
        return dynamics.stick_acceleration(theta, theta_dot, 0.0, PLANT) + helper(theta), memory

    before = fingerprint(law)
    monkeypatch.setitem(globals(), "helper", other_helper)
    assert fingerprint(law) != before
    monkeypatch.undo()
    assert fingerprint(law) == before
    monkeypatch.setattr(dynamics, "stick_acceleration", other_helper)
    assert fingerprint(law) != before


def functions_of(module: ModuleType) -> dict[str, FunctionType]:
    """The plain functions that a module defines, also those below numba's decorators."""
    found = {}
    for name, value in vars(module).items():
        function = getattr(value, "_defn", None) or getattr(value, "py_func", value)
        if isinstance(function, FunctionType) and function.__module__ == module.__name__:
            found[name] = function
    return found


# What runs in Python alone, and the physics' own way through a whole step, of which the kernel takes the parts.
NOT_COMPILED = {
    "pack", "build", "bind", "_own_fingerprint", "observation_names", "observation_bounds", "parameter_bounds",
    "check_arrays", "step", "arccos", "sines_and_cosines", "_evaluate", "_compiled",
    "_exponential", "exp", "tanh", "logarithm", "log", "interpolate", "power_of_two", "_llvm_power_of_two",
}  # fmt: skip


COMPILED = [
    pytest.param(function, id=f"{module.__name__.rpartition('.')[2]}.{name}")
    for module in (elementary, dynamics, observation, task, kernels)
    for name, function in functions_of(module).items()
    if name not in NOT_COMPILED
]


@pytest.mark.parametrize("function", COMPILED)
def test_an_edit_of_any_compiled_function_changes_the_kernels_fingerprint(function, monkeypatch):
    before = fingerprint(kernels.advance)
    code = function.__code__
    monkeypatch.setattr(function, "__code__", code.replace(co_consts=(*code.co_consts, "edited")))
    assert fingerprint(kernels.advance) != before


@pytest.mark.parametrize(
    ("module", "names"),
    [
        (elementary, [name for name in vars(elementary) if re.fullmatch(r"TURN.*|ROUNDING|[SC]_\d", name)]),
        (dynamics, [name for name, value in vars(dynamics).items() if isinstance(value, (int, float))]),
        (task, ["THETA_LIMIT", "RATE_LIMIT"]),
        (
            kernels,
            [
                "LANES",
                "MEMORY",
                "CONSTANTS",
                "SETTINGS",
                "HALTED",
                "DIVERGED",
                "MEMORY_SIZE",
                "PIVOT_TORQUE_ON_CONTACT",
            ],
        ),
    ],
    ids=["elementary", "dynamics", "task", "kernels"],
)
def test_an_edit_of_any_compiled_constant_changes_the_kernels_fingerprint(module, names, monkeypatch):
    before = fingerprint(kernels.advance)
    assert len(names) >= 2
    for name in names:
        with monkeypatch.context() as patch:
            patch.setattr(module, name, getattr(module, name) * 1.0000001 + 1e-300)
            assert fingerprint(kernels.advance) != before, name
    assert fingerprint(kernels.advance) == before


@pytest.mark.parametrize("field", layout.AT._fields)
def test_an_edit_of_where_a_row_begins_changes_the_kernels_fingerprint(field, monkeypatch):
    before = fingerprint(kernels.advance)
    monkeypatch.setattr(kernels, "AT", layout.AT._replace(**{field: 1 + getattr(layout.AT, field)}))
    assert fingerprint(kernels.advance) != before


@pytest.mark.parametrize(
    ("function", "name", "module"),
    [(kernels.advance, "AT", kernels), (dynamics.step, "Plant", dynamics), (kernels.advance, "StepSettings", kernels)],
)
def test_another_order_of_the_fields_of_a_named_tuple_changes_the_fingerprint(function, name, module, monkeypatch):
    # The code says the fields' names alone, and the values may stand where they stood: so do those of `AT`.
    before, found = fingerprint(function), getattr(module, name)
    kind = found if isinstance(found, type) else type(found)
    hints = list(kind.__annotations__.items())
    for fields in ([hints[1], hints[0], *hints[2:]], [(hints[0][0], complex), *hints[1:]]):
        other = NamedTuple(kind.__name__, fields)
        monkeypatch.setattr(module, name, other if isinstance(found, type) else other(*found))
        same = not isinstance(found, type) and fields[0][0] == hints[0][0]
        assert (fingerprint(function) == before) == same
    monkeypatch.undo()
    assert fingerprint(function) == before


SCRIPT = """
import json, sys, numpy as np
import laws
from capsule_gym import CapsuleEnv, Controller
torques, hits = [], 0
for gain in map(float, sys.argv[1:]):
    env = CapsuleEnv(controller=Controller("own", laws.make_law(gain), np.zeros((1, 2))))
    env.reset(seed=0, options={"state": [0.5, 0.0, 0.0, 0.0]})
    torques.append(env.step(np.zeros(1, np.float32))[4]["torque"])
    hits += sum(env.simulation._kernel.stats.cache_hits.values())
print(json.dumps([torques, hits]))
"""


LAW = """
import numba

def make_law(gain):
    @numba.njit
    def helper(value):
        return FACTOR * gain * value

    def law(theta, theta_dot, x, x_dot, memory, reference):
        return -helper(0.5), memory

    return law
"""


def test_disk_cache_hits_in_a_new_process_and_never_serves_another_law(tmp_path: Path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])

    def run(*gains: float, factor: float = 1.0) -> list:
        (tmp_path / "laws.py").write_text(LAW.replace("FACTOR", str(factor)))
        command = [sys.executable, "-c", SCRIPT, *map(str, gains)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        torques, hits = json.loads(done.stdout)
        return [[round(torque, 3) for torque in torques], hits]

    assert run(0.5) == [[-0.25], 0]
    # Compiled in a process like the one before: whatever numba counts stands at the same number.
    assert run(0.8) == [[-0.4], 0]
    assert run(0.5, 0.8) == [[-0.25, -0.4], 2]
    # A helper is edited, not the law itself.
    assert run(0.5, factor=1.2) == [[-0.3], 0]


# Prints the bits of a batch after a second of torques under which everything happens.
BATCH_SCRIPT = """
import hashlib
import numpy as np
from capsule_gym.simulation import Simulation

simulation = Simulation(70)
simulation.reset(np.arange(70), M=[0.5] * 70, mu=[0.05] * 70)
rng = np.random.default_rng(0)
for _ in range(50):
    simulation.step(rng.uniform(-1.0, 1.0, 70))
print(hashlib.sha256(simulation.world.tobytes()).hexdigest())
"""


def test_a_loaded_kernel_gives_the_bits_of_a_compiled_one_and_is_never_stale(tmp_path: Path):
    copied = tmp_path / "capsule_gym"
    shutil.copytree(Path(__file__).parents[2] / "capsule_gym", copied, ignore=shutil.ignore_patterns("__pycache__"))
    # Neither may Python's own cache serve the source of before the edit.
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = str(tmp_path)

    def run() -> tuple[str, int]:
        command = [sys.executable, "-c", BATCH_SCRIPT]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        lines = done.stderr.splitlines()
        assert all(line.startswith("capsule_gym: compiling the physics with no control law") for line in lines)
        return done.stdout.strip(), len(lines)

    compiled, announced = run()
    assert announced == 1
    assert run() == (compiled, 0)

    # The same size and the same date: nothing of the file but its content tells of the edit.
    source = copied / "dynamics.py"
    original, times = source.read_text(encoding="utf-8"), source.stat()
    edited = original.replace("fma(p.g / p.l, sincos(theta)[0], free)", "fma(p.g / p.l, sincos(theta)[1], free)")
    assert edited != original
    source.write_text(edited, encoding="utf-8")
    os.utime(source, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert (source.stat().st_size, source.stat().st_mtime_ns) == (times.st_size, times.st_mtime_ns)
    different, announced = run()
    assert (different != compiled, announced) == (True, 1)
    # Both are kept.
    source.write_text(original, encoding="utf-8")
    assert run() == (compiled, 0)
