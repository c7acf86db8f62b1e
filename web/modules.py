"""The functions of the package that go into WebAssembly: `build` returns their modules.

One module for each control law holds the agent step with that law in it and the beginning of an episode; one more
holds the networks of trained policies. All work in one memory that the page supplies: arrays are pointers into it.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba import types
from numba.np.arrayobj import get_cfarray_intrinsic

import baselines
from capsule_gym import exponential, kernels, network, resets, task
from capsule_gym.compilation import fingerprint, inner, rebound
from capsule_gym.controller import Controller, find_controller
from capsule_gym.files import write_bytes_atomically
from capsule_gym.identification import CELLS
from capsule_gym.kernels import LANES
from capsule_gym.parameters import NOMINAL
from capsule_gym.simulation import NO_CONTROLLER, count_rows
from web.assembly import Entry, assemble

# The task without a law, and the module of the networks; the other names are those of laws.
DIRECT, NETWORK = "direct", "network"
TASKS = (DIRECT, *baselines.__all__)

ROOT = Path(__file__).resolve().parents[1]
# Modules that have been built before, each under a hash of all that it is made of.
CACHE = ROOT / "build" / "web"

# The most entries that an observation can have. Of a single one only the first row is read, wherever the next begins.
ENTRIES = len(task.observation_names(True, True))
STARTS = kernels.Row.torque
NUMBERS, FLOATS, INTEGERS = types.CPointer(types.float64), types.CPointer(types.float32), types.CPointer(types.int64)

array = get_cfarray_intrinsic("C", None)


@lru_cache
def find_law(name: str) -> Controller | None:
    """The law of one of `TASKS`; None for `DIRECT`."""
    return None if name == DIRECT else find_controller(f"baselines:{name}")


def law_entries(law: Controller | None) -> list[Entry]:
    """What the module of a law exports: `begin`, which resets an environment, and `step`."""
    controller = law or NO_CONTROLLER
    memory_size, reference_size = len(controller.memory), controller.reference.shape[1]
    digest = hashlib.sha256(controller.name.encode()).hexdigest()[:16]
    pivot = NOMINAL.plant().pivot_torque_on_contact
    bindings = kernels.bind(controller.law, digest, memory_size, reference_size, pivot)
    advance, renew = inner(rebound(kernels.advance, "advance", bindings)), inner(resets.renew)
    size, to_int = count_rows(law) * LANES, types.int32

    def begin(  # type: ignore[no-untyped-def]
        world, fixed, fixed_size, observations, memory, m, g, starts, rows, episodes
    ):
        blocks = array(world, (1, size))
        cells, start = array(memory, (memory_size,)), array(starts, (STARTS, 1))
        renew(blocks, cells, m, g, array(rows, (1,)), start, array(episodes, (1,)))
        return to_int(advance(blocks, 0, 1, True, array(fixed, (fixed_size,)), array(observations, (1, ENTRIES))))

    def step(world, fixed, fixed_size, observations):  # type: ignore[no-untyped-def]
        blocks = array(world, (1, size))
        return to_int(advance(blocks, 0, 1, False, array(fixed, (fixed_size,)), array(observations, (1, ENTRIES))))

    common = (NUMBERS, NUMBERS, types.int32, FLOATS)
    start = (NUMBERS, types.float64, types.float64, NUMBERS, INTEGERS, INTEGERS)
    return [Entry("begin", begin, types.int32, (*common, *start)), Entry("step", step, types.int32, common)]


def network_entries() -> list[Entry]:
    """What the module of the networks exports: `act`, one action of one environment, and `log`."""

    def act(packed, size, observations, memory, inputs, lanes, units):  # type: ignore[no-untyped-def]
        return network.act_apart(
            array(packed, (size,)),
            array(observations, (1, ENTRIES)),
            0,
            1,
            array(memory, (CELLS,)),
            array(inputs, (1, ENTRIES + CELLS)),
            array(lanes, (2, units * LANES)),
        )[0]

    def log(x):  # type: ignore[no-untyped-def]
        return exponential.logarithm(x)

    arguments = (NUMBERS, types.int32, FLOATS, NUMBERS, FLOATS, NUMBERS, types.int32)
    return [Entry("act", act, types.float64, arguments), Entry("log", log, types.float64, (types.float64,))]


def find_entries(name: str) -> list[Entry]:
    """What the module of that name exports: `NETWORK`, or one of `TASKS`."""
    return network_entries() if name == NETWORK else law_entries(find_law(name))


def build(names: Sequence[str], cache: Path | None = CACHE) -> dict[str, bytes]:
    """The modules of these names.

    Args:
        names: `NETWORK`, or of `TASKS`.
        cache: a folder of modules that were built before; None builds all.

    Raises:
        subprocess.CalledProcessError: if one cannot be built; what the compiler says is on stderr.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = cache or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        # Laws that differ in their tables alone have one module.
        files = {name: folder / f"{_digest(name)}.wasm" for name in names}
        missing = {file: name for name, file in files.items() if not file.is_file()}
        if missing:
            # numba's optimiser looks at this processor, and its disk cache does not know whether it was on.
            environment = {**os.environ, "NUMBA_OPT": "0", "NUMBA_CACHE_DIR": str(Path(temporary) / "cache")}
            # Without the optimiser it also refuses to keep some functions on disk, and warns of each.
            command = [
                sys.executable,
                "-W",
                "ignore",
                "-m",
                "web.modules",
                *(f"{name}={file}" for file, name in missing.items()),
            ]
            subprocess.run(command, cwd=ROOT, env=environment, check=True)
        return {name: file.read_bytes() for name, file in files.items()}


def _digest(name: str) -> str:
    """A hash of all that a module is made of, and made with."""
    parts: list[Any] = [platform.python_version(), numba.__version__, llvmlite.__version__]
    parts += [(Path(__file__).with_name(file)).read_bytes() for file in ("assembly.py", "fused.py", "modules.py")]
    parts += [(entry.name, entry.arguments, fingerprint(entry.function)) for entry in find_entries(name)]
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def main(arguments: Sequence[str]) -> None:
    """Builds modules in this process, in which numba's optimiser is off.

    Args:
        arguments: "name=file" each.
    """
    for argument in arguments:
        name, _, file = argument.partition("=")
        write_bytes_atomically(Path(file), assemble(find_entries(name)))


if __name__ == "__main__":
    main(sys.argv[1:])
