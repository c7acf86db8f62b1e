"""The step of the speed task in plain C (`plain.c`), compiled for the core's level of instructions."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from capsule_gym import native
from capsule_gym.layout import Row
from capsule_gym.simulation import Simulation

SOURCE = Path(__file__).with_name("plain.c")
# The fields of its settings.
FIELDS = (
    "m l g k c static_ratio backward_ratio torque_limit physics_dt energy_weight termination_penalty stick_threshold"
)
OPTIONS = ("-std=c99", "-O3", "-ffast-math", "-fPIC", "-shared")
PROCESSORS = {"v4": ("-march=native", "-mprefer-vector-width=512"), "v3": ("-march=x86-64-v3",)}


def find_compiler() -> str | None:
    """The command of the C compiler: the environment variable CC, or what is installed."""
    return os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)


class Plain:
    """Copies of the environments of a simulation, whose number is a multiple of its lanes.

    Args:
        compiler: command of the C compiler.
        simulation: environments of the speed task with direct torque, which begin an episode.

    Attributes:
        world: the rows of `Simulation.world` before `Row.clock`.
    """

    def __init__(self, compiler: str, simulation: Simulation) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "plain.so")
            options = [*OPTIONS, *PROCESSORS.get(native.LEVEL, ()), str(SOURCE), "-lm", "-o", str(path)]
            subprocess.run([*compiler.split(), *options], check=True)
            self._library = ctypes.CDLL(str(path))
        rows = ctypes.c_int.in_dll(self._library, "ROWS").value
        whole = native.aligned_zeros((len(simulation.world), rows, simulation.lanes))
        self.world = whole[:, : Row.clock]
        self.world[...] = simulation.world[:, : Row.clock]
        values = {**simulation.capsule.plant()._asdict(), **simulation.settings._asdict()}
        # The library reads these arrays by their addresses.
        self._arrays = whole, native.ordered(FIELDS.split(), values), np.zeros((simulation.num_envs, 5), np.float32)

    def step(self, actions: np.ndarray) -> None:
        """One agent step, as `Simulation.step`."""
        world, settings, observations, torques = (
            ctypes.c_void_p(native.address(each)) for each in (*self._arrays, actions)
        )
        self._library.step(world, len(self.world), settings, torques, observations)
