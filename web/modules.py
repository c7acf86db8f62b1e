"""The functions of the package that are compiled to WebAssembly: `build` returns their modules.

There is a module for the agent step of each task, one for each control law, which the step imports, and one for shared
functions: networks of trained policies and the start of an episode. All modules work in one memory that the page
supplies: arrays are pointers.
"""

from __future__ import annotations

import ctypes
import hashlib
import platform
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.sigutils import normalize_signature
from numba.np.arrayobj import get_cfarray_intrinsic

import baselines
from baselines.gaits import families
from baselines.laws import TASK_LAWS
from capsule_gym import kernels, layout, resets
from capsule_gym.compilation import fingerprint, inlined, intrinsic, jitable, rebound
from capsule_gym.config import find_task
from capsule_gym.controller import Controller, find_controller
from capsule_gym.elementary import log
from capsule_gym.files import write_atomically
from capsule_gym.layout import LANES
from capsule_gym.network import act_lanes
from capsule_gym.observation import CELLS, observation_names
from capsule_gym.parameters import NOMINAL, VARIED
from capsule_gym.settings import NO_CONTROLLER
from capsule_gym.task import TASKS
from web import assembly
from web.assembly import Entry, assemble, optimise
from web.fused import fused

# The name for no law; the other names are those of laws.
DIRECT = "direct"
LAWS = (DIRECT, *baselines.__all__, *TASK_LAWS)
# Task and `Plant.extended` of each step. Only the speed task has a step for disturbances and further constants.
STEPS = {**{task: (task, 0.0) for task in TASKS}, "speed-varied": ("speed", VARIED)}
# The module that all drivers need, in addition to those of their step and their law.
COMMON = "common"
# The name under which the step imports a law.
LAW = "evaluate_law"

ROOT = Path(__file__).resolve().parents[1]
# Cache of built modules, each named by a hash of its sources and tools.
CACHE = ROOT / "build" / "web"

# Largest number of entries in an observation. Arrays with a single row may have this row length, whatever their size.
ENTRIES = max(len(observation_names(True, True, find_task(task).entries)) for task in TASKS)
STARTS = layout.Row.torque
NUMBERS, FLOATS, INTEGERS = types.CPointer(types.float64), types.CPointer(types.float32), types.CPointer(types.int64)
WORDS = types.CPointer(types.uint64)

array = get_cfarray_intrinsic("C", None)


@lru_cache
def find_law(name: str) -> Controller | None:
    """The law of a name in `LAWS`; None for `DIRECT`."""
    return None if name == DIRECT else find_controller(f"baselines:{name}")


def _define_call_linked_law(
    typing_context: Any, block: Any, n: Any, fixed: Any, cycle: Any, limit: Any, tick: Any
) -> Any:
    given, result = normalize_signature(kernels.LAW_SIGNATURE)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows, table = (context.make_array(signature.args[n])(context, builder, arguments[n]) for n in (0, 2))
        passed = [rows.data, rows.nitems, arguments[1], table.data, table.nitems, *arguments[3:]]
        kind = ir.FunctionType(ir.IntType(32), [value.type for value in passed])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, LAW), passed)
        return context.get_dummy_value()

    return result(*given), generate


@intrinsic(_define_call_linked_law)
def call_linked_law(block: Any, n: int, fixed: Any, cycle: int, torque_limit: float, tick: float) -> None:
    """`kernels.call_law` for a law that the step imports under the name LAW."""


def step_entry(task: str, extended: float) -> Entry:
    """The function `advance`, which steps an environment or begins its episode; it imports its law."""
    step = inlined(rebound(kernels.step_of(find_task(task), extended), {"call_law": call_linked_law}))
    plant = NOMINAL.plant()
    bindings = {"step": step, "PIVOT_TORQUE_ON_CONTACT": plant.pivot_torque_on_contact, "EXTENDED": extended}
    compiled = jitable(rebound(kernels.advance, bindings))
    to_int = types.int32

    def advance(world, size, begin, fixed, fixed_size, observations, entries):  # type: ignore[no-untyped-def]
        blocks, shown = array(world, (1, size)), array(observations, (1, entries))
        return to_int(compiled(blocks, 0, 1, begin != 0, array(fixed, (fixed_size,)), shown))

    count = types.int32
    return Entry("advance", advance, count, (NUMBERS, count, count, NUMBERS, count, FLOATS, count))


def law_entry(law: Controller | None) -> Entry:
    """The function that `call_linked_law` calls."""
    controller = law or NO_CONTROLLER
    columns = controller.reference.shape[1]
    row = columns + (find_task(controller.task).rows if controller.task else 0)
    sizes = {"MEMORY_SIZE": len(controller.memory), "REFERENCE_SIZE": columns, "ROW_SIZE": row}
    compiled = jitable(rebound(kernels.evaluate_law, {"law": inlined(controller.law), **sizes}))
    to_int = types.int32

    def evaluate_law(block, size, n, fixed, fixed_size, cycle, torque_limit, tick):  # type: ignore[no-untyped-def]
        compiled(array(block, (size,)), n, array(fixed, (fixed_size,)), cycle, torque_limit, tick)
        return to_int(0)

    number, count = types.float64, types.int64
    return Entry(LAW, evaluate_law, types.int32, (NUMBERS, count, count, NUMBERS, count, count, number, number))


def common_entries() -> list[Entry]:
    """The exports of the shared module.

    `renew` sets an environment to the start of an episode, `draw` draws the episode's further values, `act` computes an
    action of a policy, `log` the logarithm of the energy weight that a policy observes, and `gait` an action of a gait
    with a clock.
    """

    def renew(world, size, memory, memory_size, m, g, starts, rows, episodes):  # type: ignore[no-untyped-def]
        blocks, cells, start = array(world, (1, size)), array(memory, (memory_size,)), array(starts, (STARTS, 1))
        resets.renew(blocks, cells, m, g, array(rows, (1,)), start, array(episodes, (1,)))
        return types.int32(0)

    def draw(table, lines, rows, key, episodes, values):  # type: ignore[no-untyped-def]
        drawn = array(table, (lines, 6)), array(rows, (1,)), array(key, (1, 2)), array(episodes, (1,))
        resets.draw_rows(drawn[0], drawn[1], drawn[2], drawn[3], array(values, (lines, 1)))
        return types.int32(0)

    def act(network, size, observations, memory, inputs, lanes, units):  # type: ignore[no-untyped-def]
        shown, given = array(observations, (1, ENTRIES)), array(inputs, (1, ENTRIES + CELLS))
        cells, room = array(memory, (CELLS,)), array(lanes, (2, units * LANES))
        return room[act_lanes(array(network, (size,)), shown, 0, 1, cells, given, room), 0]

    def gait(gaits, size, n, time, observations):  # type: ignore[no-untyped-def]
        seen, number = array(observations, (3,)), types.float64
        state = number(seen[0]), number(seen[1]), number(seen[2])
        return families.action(array(gaits, (size,)), n * families.WIDTH, time, *state)

    number, count = types.float64, types.int32
    starting = (NUMBERS, count, NUMBERS, count, number, number, NUMBERS, INTEGERS, INTEGERS)
    return [
        Entry("renew", renew, count, starting),
        Entry("draw", draw, count, (NUMBERS, count, INTEGERS, WORDS, INTEGERS, NUMBERS)),
        Entry("act", act, number, (NUMBERS, count, FLOATS, NUMBERS, FLOATS, NUMBERS, count)),
        Entry("gait", gait, number, (NUMBERS, count, count, number, FLOATS)),
        Entry("log", log, number, (number,)),
    ]


def entries_of(name: str) -> list[Entry]:
    """The exports of a module, by its name."""
    if name == COMMON:
        return common_entries()
    return [step_entry(*STEPS[name]) if name in STEPS else law_entry(find_law(name))]


def build(names: Sequence[str], cache: Path | None = CACHE) -> dict[str, bytes]:
    """Builds modules by name (`COMMON`, or a key of `STEPS` or `LAWS`), or reads them from the cache."""
    # Laws that differ only in their tables share a module.
    digests = {name: _digest(name) for name in names}
    built: dict[str, bytes] = {}
    if cache:
        files = {digest: cache / f"{digest}.wasm" for digest in digests.values()}
        built = {digest: file.read_bytes() for digest, file in files.items() if file.is_file()}
    missing = {digest: name for name, digest in digests.items() if digest not in built}
    if missing:
        print(f"compiling {len(missing)} modules to WebAssembly, once; a minute or two:", file=sys.stderr)
        # numba looks up the address of every called function.
        llvm.add_symbol(LAW, ctypes.cast(ctypes.pythonapi.Py_IsInitialized, ctypes.c_void_p).value)
    for digest, name in missing.items():
        entries = entries_of(name)
        built[digest] = assemble(optimise(entries), [entry.name for entry in entries])
        if cache:
            cache.mkdir(parents=True, exist_ok=True)
            write_atomically(cache / f"{digest}.wasm", built[digest])
        print(f"  {name}", file=sys.stderr, flush=True)
    return {name: built[digest] for name, digest in digests.items()}


def _digest(name: str) -> str:
    """A hash of a module's sources and of the tools that build it."""
    entries = entries_of(name)
    parts: list[Any] = [platform.python_version(), numba.__version__, llvmlite.__version__]
    parts += [Path(assembly.__file__).read_bytes(), fingerprint(fused)]
    parts += [(entry.name, entry.arguments, fingerprint(entry.function)) for entry in entries]
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
