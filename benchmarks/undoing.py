"""The kernel with one trick undone at a time, for `python -m benchmarks.tricks`.

The kernel runs as it is, and with one trick undone at a time. numba takes globals for constants, so a trick is undone
by binding a global anew before anything is compiled, each in a process of its own. The processes take turns: the ratios
of one run mean something, the absolute numbers little. Direct torque, one core, and nothing but the kernel.
"""

from __future__ import annotations

import inspect
import math
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from benchmarks.contenders import ACTION_SCALE, DRAWS, SEED
from benchmarks.timing import Contender, Rate, Stepper
from capsule_gym import dynamics, elementary, kernels, simulation
from capsule_gym.compilation import inlined

BATCHES = (1024, 16384)
# What a child runs; its argument is the trick's name in `UNDO`.
CHILD = "import sys; from benchmarks import undoing; undoing.serve(sys.argv[1])"


@inlined
def library_sincos(angle: float) -> tuple[float, float]:
    """Sine and cosine of the C library: calls, which no compiler takes several environments through."""
    return math.sin(angle), math.cos(angle)


@inlined
def multiply_add(a: float, b: float, c: float) -> float:
    """A product and a sum, each rounded."""
    return a * b + c


@inlined
def nothing() -> None:
    """Leaves the width of the vectors to the compiler."""


def set_lanes(lanes: int) -> None:
    """Runs the source of `kernels` once more, with that many lanes: other constants are computed from their number."""
    line = f"\nLANES = {kernels.LANES}\n"
    source = inspect.getsource(kernels)
    if source.count(line) != 1:
        raise ValueError(f"{kernels.__file__} must hold the line {line.strip()!r} once")
    changed = source.replace(line, f"\nLANES = {lanes}\n")
    exec(compile(changed, str(kernels.__file__), "exec"), vars(kernels))
    vars(simulation)["LANES"] = lanes


def rebind(name: str, value: Callable[..., Any]) -> None:
    """Binds a function anew in every module that has it."""
    scopes = [scope for scope in map(vars, (elementary, dynamics, kernels)) if name in scope]
    if not scopes:
        raise ValueError(f"none of the compiled modules has {name!r}")
    for scope in scopes:
        scope[name] = value


AS_IT_IS = "as it is"
UNDO: dict[str, Callable[[], None]] = {
    AS_IT_IS: lambda: None,
    "sin and cos of the C library": partial(rebind, "sincos", library_sincos),
    "multiplications and additions rounded apart": partial(rebind, "fma", multiply_add),
    "vectors as wide as the compiler likes": partial(rebind, "use_widest_vectors", nothing),
    **{
        f"{lanes} lane{'s' if lanes > 1 else ''} instead of {kernels.LANES}": partial(set_lanes, lanes)
        for lanes in (1, 8, 16, 32, 128)
    },
}


@lru_cache
def batch(num_envs: int) -> Callable[[int], None]:
    """Environments in this process, as the function that takes a number of steps of the kernel."""
    environments = simulation.Simulation(num_envs)
    environments.reset(np.arange(num_envs))
    actions = np.random.default_rng(SEED).uniform(-ACTION_SCALE, ACTION_SCALE, (DRAWS, num_envs))

    def step(count: int) -> None:
        for n in range(count):
            environments.write(kernels.Row.action, actions[n % DRAWS])
            environments._run(begin=False)

    return step


def serve(name: str) -> None:
    """Undoes a trick, and takes as many steps as each line that comes in says, with as many environments."""
    UNDO[name]()
    for line in sys.stdin:
        num_envs, count = map(int, line.split())
        batch(num_envs)(count)
        print("done", flush=True)


@lru_cache
def child(name: str) -> subprocess.Popen[str]:
    """A process that serves with a trick undone."""
    return subprocess.Popen(
        [sys.executable, "-c", CHILD, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def stepper(name: str, num_envs: int) -> Stepper:
    """A batch in the process of its trick."""
    process = child(name)
    assert process.stdin is not None and process.stdout is not None
    orders, answers = process.stdin, process.stdout

    def step(count: int) -> None:
        print(num_envs, count, file=orders, flush=True)
        if not answers.readline():
            raise RuntimeError(f"the process for {name!r} has ended")

    def close() -> None:
        orders.close()
        process.wait()

    return Stepper(step, close)


def contenders() -> dict[tuple[str, int], Contender]:
    """All batches, by what is undone and their size."""
    return {(name, n): Contender(name, partial(stepper, name, n), n) for name in UNDO for n in BATCHES}


def rows(rates: Mapping[tuple[str, int], Rate]) -> list[list[str]]:
    """The table; a gain is what the kernel loses without the trick, as a factor."""
    table = [["", *(cell for n in BATCHES for cell in (f"{n:,} envs, env-steps/s", "IQR", "trick gains"))]]
    for name in UNDO:
        cells = []
        for n in BATCHES:
            rate, ours = rates[name, n], rates[AS_IT_IS, n]
            gain = "" if name == AS_IT_IS else f"{ours.median / rate.median:.2f}"
            cells += [f"{rate.median:,.0f}", f"{rate.spread:.0%}", gain]
        table.append([name, *cells])
    return table
