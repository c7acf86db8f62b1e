"""Time of the core's step over that of the same work in plain C (`plain.c`): `python -m benchmarks.plain`.

The states of both must agree. Neither side resets an environment or writes infos.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measurement import OutputArgs, machine, take_turns
from benchmarks.regression import seeded
from benchmarks.throughput import ACTION_SCALE, SEED
from capsule_gym import native
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.layout import LANES, Row
from capsule_gym.simulation import Simulation

COMMAND = "python -m benchmarks.plain"
SOURCE = Path(__file__).with_name("plain.c")
# The fields of `struct settings`.
SETTINGS = "m l g k c static_ratio backward_ratio torque_limit physics_dt energy_weight termination_penalty stick_threshold"
OPTIONS = ("-std=c99", "-O3", "-ffast-math", "-fPIC", "-shared")
# Instructions of the core's levels.
PROCESSORS = {"v4": ("-march=native", "-mprefer-vector-width=512"), "v3": ("-march=x86-64-v3",), "portable": ()}
NUM_ENVS, STEPS = 1024, 40
# Largest difference in any row, in SI units; the rewards are in cm.
TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """The time of the core's step over that of the same work in plain C. Needs a C compiler.

    Examples:
      python -m benchmarks.plain
      CAPSULE_GYM_LEVEL=v3 CC=clang python -m benchmarks.plain
    """

    turns: Count = 30
    """Measurements of each side, of which the 10th percentile is used."""


def compile_plain(compiler: str) -> ctypes.CDLL:
    """Compiles `plain.c` for the core's level of instructions."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "plain.so")
        subprocess.run([compiler, *OPTIONS, *PROCESSORS[native.LEVEL], SOURCE, "-o", library, "-lm"], check=True)
        return ctypes.CDLL(str(library))


def core_steps(simulation: Simulation, actions: np.ndarray) -> Callable[[], float]:
    """A function that steps the environments from their present state and returns the seconds of a step of each."""
    start = simulation.world.copy()

    def turn() -> float:
        simulation.world[...] = start
        began = time.process_time()
        for each in actions:
            simulation.step(each)
        return (time.process_time() - began) / actions.size

    return turn


def plain_steps(library: ctypes.CDLL, simulation: Simulation, actions: np.ndarray) -> tuple[np.ndarray, Callable[[], float]]:
    """The same in plain C, with the rows of its copy of the environments, shape (blocks, rows, LANES)."""
    start = simulation.world[:, : Row.clock].copy()
    rows = ctypes.c_int.in_dll(library, "ROWS").value
    world = native.aligned_zeros((len(start), rows, LANES))
    values = {**simulation.capsule.plant()._asdict(), **simulation.settings._asdict()}
    settings = native.ordered(SETTINGS.split(), values)
    observations = np.zeros((NUM_ENVS, 5), np.float32)
    # `data_as` keeps the arrays alive.
    blocks, constants, seen, *torques = (
        array.ctypes.data_as(ctypes.c_void_p) for array in (world, settings, observations, *actions)
    )

    def turn() -> float:
        world[:, : Row.clock] = start
        began = time.process_time()
        for each in torques:
            library.step(blocks, len(start), constants, each, seen)
        return (time.process_time() - began) / actions.size

    return world[:, : Row.clock], turn


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 1 if the two disagree."""
    args = parse(Args, COMMAND, arguments)
    compiler = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:
        refuse(COMMAND, "a C compiler must be in PATH")
    simulation = seeded(NUM_ENVS, randomization="wide")
    actions = ACTION_SCALE * np.random.default_rng(SEED).uniform(-1.0, 1.0, (STEPS, NUM_ENVS))
    rows, plain = plain_steps(compile_plain(compiler), simulation, actions)
    turns = {"core": core_steps(simulation, actions), "plain C": plain}
    seconds = take_turns(turns, args.turns)
    difference = np.abs(simulation.world[:, : Row.clock] - rows).max()
    core, other = (1e9 * float(np.percentile(seconds[name], 10)) for name in turns)
    print(f"core {core:.0f} ns, plain C {other:.0f} ns, ratio {core / other:.2f}, difference {difference:.1e}. {machine()}.")
    return int(not difference <= TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
