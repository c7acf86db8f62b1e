"""The functions of the package that go into WebAssembly: `build` returns their modules.

One module for each control law holds the agent step with that law in it; one more holds what they share, the networks
of trained policies and the beginning of an episode. All work in one memory that the page supplies: arrays are pointers.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba import types
from numba.np.arrayobj import get_cfarray_intrinsic

from agents.controllers import find_law
from baselines.gaits import families
from capsule_gym import kernels, layout, resets
from capsule_gym.compilation import fingerprint, inner, rebound
from capsule_gym.controller import Controller
from capsule_gym.elementary import logarithm
from capsule_gym.files import write_atomically
from capsule_gym.identification import CELLS
from capsule_gym.layout import LANES
from capsule_gym.network import act_lanes
from capsule_gym.observation import observation_names
from capsule_gym.parameters import NOMINAL
from capsule_gym.simulation import NO_CONTROLLER, count_rows
from web import assembly
from web.assembly import Entry, assemble
from web.fused import fused

# The module that all tasks need besides their own, which has the task's name.
COMMON = "common"

ROOT = Path(__file__).resolve().parents[1]
# Modules that have been built before, each under a hash of all that it is made of.
CACHE = ROOT / "build" / "web"

# The most entries that an observation can have. Of a single one only the first row is read, wherever the next begins.
ENTRIES = len(observation_names(True, True))
STARTS = layout.Row.torque
NUMBERS, FLOATS, INTEGERS = types.CPointer(types.float64), types.CPointer(types.float32), types.CPointer(types.int64)

array = get_cfarray_intrinsic("C", None)


def law_entries(law: Controller | None) -> list[Entry]:
    """What the module of a law exports: `advance`, which takes an environment a step further or begins its episode."""
    controller = law or NO_CONTROLLER
    memory_size, reference_size = len(controller.memory), controller.reference.shape[1]
    digest = hashlib.sha256(controller.name.encode()).hexdigest()[:16]
    pivot = NOMINAL.plant().pivot_torque_on_contact
    bindings = kernels.bind(controller.law, digest, memory_size, reference_size, pivot)
    compiled = inner(rebound(kernels.advance, "advance", bindings))
    size, to_int = count_rows(law) * LANES, types.int32

    def advance(world, begin, fixed, fixed_size, observations):  # type: ignore[no-untyped-def]
        blocks, shown = array(world, (1, size)), array(observations, (1, ENTRIES))
        return to_int(compiled(blocks, 0, 1, begin != 0, array(fixed, (fixed_size,)), shown))

    arguments = (NUMBERS, types.int32, NUMBERS, types.int32, FLOATS)
    return [Entry("advance", advance, types.int32, arguments)]


def common_entries() -> list[Entry]:
    """What the module without a law exports.

    `renew` gives an environment the first values of an episode, `act` is one action of a policy, `log` the logarithm of
    the energy weight that it is told, and `gait` one action of a gait with a clock.
    """
    compiled = inner(resets.renew)

    def renew(world, size, memory, memory_size, m, g, starts, rows, episodes):  # type: ignore[no-untyped-def]
        blocks, cells, start = array(world, (1, size)), array(memory, (memory_size,)), array(starts, (STARTS, 1))
        compiled(blocks, cells, m, g, array(rows, (1,)), start, array(episodes, (1,)))
        return types.int32(0)

    def act(network, size, observations, memory, inputs, lanes, units):  # type: ignore[no-untyped-def]
        shown, given = array(observations, (1, ENTRIES)), array(inputs, (1, ENTRIES + CELLS))
        cells, room = array(memory, (CELLS,)), array(lanes, (2, units * LANES))
        return act_lanes(array(network, (size,)), shown, 0, 1, cells, given, room)[0]

    def gait(gaits, size, n, time, observations):  # type: ignore[no-untyped-def]
        seen, number = array(observations, (3,)), types.float64
        state = number(seen[0]), number(seen[1]), number(seen[2])
        return families.action(array(gaits, (size,)), n * families.WIDTH, time, *state)

    def log(x):  # type: ignore[no-untyped-def]
        return logarithm(x)

    number, count = types.float64, types.int32
    starting = (NUMBERS, count, NUMBERS, count, number, number, NUMBERS, INTEGERS, INTEGERS)
    return [
        Entry("renew", renew, count, starting),
        Entry("act", act, number, (NUMBERS, count, FLOATS, NUMBERS, FLOATS, NUMBERS, count)),
        Entry("gait", gait, number, (NUMBERS, count, count, number, FLOATS)),
        Entry("log", log, number, (number,)),
    ]


def find_entries(name: str) -> list[Entry]:
    """What the module of that name exports: `COMMON`, or one of `agents.controllers.TASKS`."""
    return common_entries() if name == COMMON else law_entries(find_law(name))


def build(names: Sequence[str], cache: Path | None = CACHE) -> dict[str, bytes]:
    """The modules of these names.

    Args:
        names: `COMMON`, or of `agents.controllers.TASKS`.
        cache: a folder of modules that were built before; None builds all.

    Raises:
        subprocess.CalledProcessError: if one cannot be built; what the compiler says is on stderr, as is the progress.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = cache or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        # Laws that differ in their tables alone have one module.
        files = {name: folder / f"{_digest(name)}.wasm" for name in names}
        missing = {file: name for name, file in files.items() if not file.is_file()}
        # numba's optimiser looks at this processor, and its disk cache does not know whether it was on.
        environment = {**os.environ, "NUMBA_OPT": "0", "NUMBA_CACHE_DIR": str(Path(temporary) / "cache")}

        def run(file: Path) -> None:
            # Without the optimiser numba refuses to keep some functions on disk, and warns of each.
            command = [sys.executable, "-W", "ignore", "-m", "web.modules", missing[file], str(file)]
            subprocess.run(command, cwd=ROOT, env=environment, check=True)
            print(f"  {missing[file]}", file=sys.stderr, flush=True)

        if missing:
            print(f"compiling {len(missing)} modules to WebAssembly, once; a minute or two:", file=sys.stderr)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(run, missing))
        return {name: file.read_bytes() for name, file in files.items()}


def _digest(name: str) -> str:
    """A hash of all that a module is made of, and made with."""
    parts: list[Any] = [platform.python_version(), numba.__version__, llvmlite.__version__]
    parts += [Path(assembly.__file__).read_bytes(), fingerprint(fused)]
    parts += [(entry.name, entry.arguments, fingerprint(entry.function)) for entry in find_entries(name)]
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def main() -> int:
    """Builds a module in this process, in which numba's optimiser is off; its arguments are its name and its file."""
    if len(sys.argv) != 3:
        print("web.modules: started by python -m web.build, for each of the modules", file=sys.stderr)
        return 2
    name, file = sys.argv[1:]
    write_atomically(Path(file), assemble(find_entries(name)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
