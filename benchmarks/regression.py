"""Whether the kernels are as fast as they should be, in ratios of one run: `python -m benchmarks.regression`.

Absolute times say nothing on another machine, ratios do. A ratio below its floor most often means that the compiler no
longer vectorises a loop. What is compared takes turns, and the median of the turns counts, so that another process
disturbs both or neither; a ratio that misses its floor is measured again before it counts.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.tables import markdown_table, text_table
from benchmarks import native
from benchmarks.contenders import ACTION_SCALE, DRAWS, LAW, SEED, THREADS, step_batch
from benchmarks.timing import available_cores, describe, machine
from capsule_gym import ENV_ID
from capsule_gym.files import to_json, write_atomically
from capsule_gym.kernels import Row
from capsule_gym.options import LAW_PHYSICS_DT, Options
from capsule_gym.simulation import Simulation

NUM_ENVS = 1024
MANY = 16384
TURNS = 15
TURN_SECONDS = 0.04
ATTEMPTS = 5
COMMENT = "<!-- Written by python -m benchmarks.regression: do not edit. -->"

# Takes one turn; returns the seconds that it counts and the steps of environments that these took.
Turn = Callable[[], tuple[float, int]]


@dataclass(frozen=True)
class Guard:
    """A ratio of two rates, or of two times.

    Attributes:
        name: what it is.
        floor: what it must reach; None where it is only shown.
        one: the rate above the line.
        other: the rate below.
    """

    name: str
    floor: float | None
    one: Turn
    other: Turn

    def measure(self) -> float:
        """The median over turns of the one and the other, side by side."""
        ratios = []
        for _ in range(TURNS):
            (seconds, steps), (other_seconds, other_steps) = self.one(), self.other()
            ratios.append(steps / seconds / (other_steps / other_seconds))
        return statistics.median(ratios)


def stepping(simulation: Simulation, kernel: Callable[[], Any], held: bool = False) -> Turn:
    """Agent steps of a simulation by a kernel alone, under random torques.

    Args:
        simulation: its environments go on from turn to turn; one that has ended is reset.
        kernel: what steps them.
        held: whether each environment keeps its first torque, so that the platform seldom turns.
    """
    n = simulation.num_envs
    simulation.reset(np.arange(n))
    draws = ACTION_SCALE * np.random.default_rng(SEED).uniform(-1.0, 1.0, (1 if held else DRAWS, n))
    taken = 0

    def turn() -> tuple[float, int]:
        nonlocal taken
        seconds, steps = 0.0, 0
        while seconds < TURN_SECONDS:
            ended = np.flatnonzero(simulation.row(Row.termination) != 0.0)
            if len(ended):
                simulation.reset(ended)
                simulation.world[:, Row.active] = 1.0
            simulation.write(Row.action, draws[taken % len(draws)])
            start = time.perf_counter()
            kernel()
            seconds += time.perf_counter() - start
            taken += 1
            steps += n
        return seconds, steps

    return turn


def seeded(num_envs: int, **settings: Any) -> Simulation:
    """Environments with a seed each, so that no two have the same plant."""
    simulation = Simulation(num_envs, Options(**settings))
    for i in range(num_envs):
        simulation.seed(i, i)
    return simulation


def ours(num_envs: int, held: bool = False, **settings: Any) -> Turn:
    """This package's kernel."""
    simulation = seeded(num_envs, **settings)
    return stepping(simulation, lambda: simulation._run(begin=False), held)


def one_at_a_time() -> Turn:
    """A single environment, without what the call from Python takes: a block with one lane in use."""
    simulation = Simulation(1)
    # Short enough for every one of the torques to leave the episode running.
    calls, torques = 200, iter(np.resize(ACTION_SCALE * np.linspace(-1.0, 1.0, 9), ATTEMPTS * TURNS))

    def turn() -> tuple[float, int]:
        simulation.reset(np.arange(1))
        simulation.write(Row.action, np.array([next(torques)]))
        marks = [time.perf_counter()]
        for last in (1, 0):
            for _ in range(calls):
                simulation._advance(0, last, False)
            marks.append(time.perf_counter())
        return (marks[1] - marks[0]) - (marks[2] - marks[1]), calls

    return turn


def in_c(flags: tuple[str, ...]) -> Turn:
    """The hand-written kernel on the same environments."""
    simulation = seeded(MANY)
    return stepping(simulation, native.Native(simulation, flags))


def whole_steps(num_envs: int) -> Turn:
    """The `step` of a native batch, with everything that it returns."""
    stepper = step_batch(ENV_ID, num_envs, ACTION_SCALE, max_episode_steps=sys.maxsize)

    def turn() -> tuple[float, int]:
        start, steps = time.perf_counter(), 0
        while time.perf_counter() - start < TURN_SECONDS:
            stepper.step(DRAWS)
            steps += DRAWS * num_envs
        return time.perf_counter() - start, steps

    return turn


def guards() -> list[Guard]:
    """Everything that is measured here."""
    direct = ours(NUM_ENVS)
    found = [
        Guard("lanes against one environment at a time", 3.0, ours(NUM_ENVS, held=True), one_at_a_time()),
        Guard(
            "adaptive law inside against direct torque, both at 1 ms",
            0.5,
            ours(NUM_ENVS, **LAW),
            ours(NUM_ENVS, physics_dt=LAW_PHYSICS_DT),
        ),
        Guard(f"whole step of {NUM_ENVS} environments against their kernel", 0.7, whole_steps(NUM_ENVS), direct),
    ]
    if native.available():
        many = ours(MANY)
        found.append(Guard(f"kernel against C, gcc {' '.join(native.STRICT)}", 0.85, many, in_c(native.STRICT)))
        found.append(Guard(f"kernel against C, gcc {' '.join(native.FAST)}", 0.6, many, in_c(native.FAST)))
    if available_cores() >= max(THREADS):
        # Shown only: what else the machine does decides it.
        found.append(Guard(f"{max(THREADS)} threads against one", None, ours(MANY, threads=max(THREADS)), ours(MANY)))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 1 where a ratio misses its floor."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.regression", description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the ratios to this new file")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table to this file")
    options = parser.parse_args(arguments)
    if options.json is not None and options.json.exists():
        parser.error(f"--json must name a new file, got {str(options.json)!r}")
    rows = [["", "ratio", "floor", ""]]
    ratios: dict[str, float] = {}
    missed = False
    for guard in guards():
        ratio = guard.measure()
        for _ in range(ATTEMPTS - 1):
            if guard.floor is None or ratio >= guard.floor:
                break
            ratio = max(ratio, guard.measure())
        low = guard.floor is not None and ratio < guard.floor
        missed |= low
        ratios[guard.name] = ratio
        floor = "" if guard.floor is None else f"{guard.floor:g}"
        rows.append([guard.name, f"{ratio:.2f}", floor, "below its floor" if low else ""])
    print(text_table(rows))
    if options.markdown is not None:
        lines = [COMMENT, "", *markdown_table(rows), "", f"{describe(machine())}.", ""]
        write_atomically(options.markdown, "\n".join(lines))
    if options.json is not None:
        write_atomically(options.json, to_json({"machine": machine(), "ratios": ratios}))
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
