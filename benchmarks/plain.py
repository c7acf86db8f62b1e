"""The step of the speed task in plain C (`plain.c`), compiled for the core's level of instructions."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from capsule_gym import native
from capsule_gym.layout import LANES, Row
from capsule_gym.simulation import Simulation

SOURCE = Path(__file__).with_name("plain.c")
# The fields of its settings.
FIELDS = (
    "m l g k c static_ratio backward_ratio torque_limit physics_dt energy_weight termination_penalty stick_threshold"
)
OPTIONS = ("-std=c99", "-O3", "-ffast-math", "-fPIC", "-c")
PROCESSORS = {"v4": ("-march=native", "-mprefer-vector-width=512"), "v3": ("-march=x86-64-v3",)}


def find_compiler() -> str | None:
    """The command of the C compiler: the environment variable CC, or what is installed."""
    return os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)


def copy_to_c(compiler: str, simulation: Simulation) -> tuple[Callable[[np.ndarray], object], np.ndarray]:
    """Copies environments of the speed task with direct torque, a multiple of the core's lanes, into plain C.

    Returns:
        Their `Simulation.step`, and the rows of `Simulation.world` before `Row.clock`.
    """
    with tempfile.TemporaryDirectory() as folder:
        compiled, path = Path(folder, "plain.o"), Path(folder, "plain.so")
        options = [*OPTIONS, *PROCESSORS.get(native.LEVEL, ()), str(SOURCE), "-o", str(compiled)]
        subprocess.run([*compiler.split(), *options], check=True)
        # Linked without -ffast-math, with which gcc makes the whole process lose subnormal numbers.
        subprocess.run([*compiler.split(), "-shared", str(compiled), "-lm", "-o", str(path)], check=True)
        library = ctypes.CDLL(str(path))
    blocks, rows = len(simulation.world), ctypes.c_int.in_dll(library, "ROWS").value
    world, observations = native.aligned_zeros((blocks, rows, LANES)), np.zeros((simulation.num_envs, 5), np.float32)
    values = {**simulation.capsule.plant()._asdict(), **simulation.settings._asdict()}
    settings = native.ordered(FIELDS.split(), values)
    first = world[:, : Row.clock]
    first[...] = simulation.world[:, : Row.clock]

    def step(actions: np.ndarray) -> None:
        b, q, u, out = (ctypes.c_void_p(native.address(each)) for each in (world, settings, actions, observations))
        library.step(b, blocks, q, u, out)

    return step, first
