"""The problems of `python -m baselines.optimum`, and what is kept of each."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import perf_counter

import numpy as np

from baselines.gaits.archive import PLANTS
from baselines.optimum.levels import LEVELS, PRODUCTION, Level, optimise
from baselines.optimum.motion import repeat
from baselines.optimum.records import Archive, Record
from baselines.optimum.solver import Problem
from capsule_gym.task import CONTROL_DT

# s
HOLDS = (0.01, 0.005)
# cm/J
ENERGY_WEIGHTS = (0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
# N: what the platform may be lighter by, times g.
MARGINS = (1.6,)
PARTS: dict[str, tuple[Problem, ...]] = {
    "plants": tuple(Problem(M=M, mu=mu) for M, mu in PLANTS),
    "margins": tuple(Problem(margin=margin) for margin in MARGINS),
    "weights": tuple(Problem(energy_weight=weight) for weight in ENERGY_WEIGHTS),
    "holds": tuple(Problem(hold=hold) for hold in HOLDS),
}


def grids_of(problem: Problem) -> Sequence[tuple[int, int, int]]:
    """The grids on which a problem is solved: finer ones where the refinement is shown, or holds are short."""
    if problem.hold < CONTROL_DT:
        return LEVELS[:3]
    return LEVELS if problem == Problem() else PRODUCTION


def record_of(problem: Problem, levels: Sequence[Level], seconds: float) -> tuple[Record, np.ndarray]:
    """What is kept of a problem, and the torques of its best motion: the one with the largest reward."""

    def reward(level: Level) -> float:
        metrics = level.motion.metrics
        value = 100.0 * metrics["distance"][0] - problem.energy_weight * metrics["energy"][0]
        return float(value) - 1e9 * float(metrics["failed"][0])

    best = max(levels, key=reward).motion
    transport = float(best.metrics["cost_of_transport"][0])
    record = Record(
        M=problem.M,
        mu=problem.mu,
        energy_weight=problem.energy_weight,
        hold=problem.hold,
        margin=problem.margin,
        grids=tuple(level.solution.grid.shape for level in levels),
        gains=tuple(round(level.solution.gain, 4) for level in levels),
        steady=tuple(round(level.steady, 4) for level in levels),
        mean_speed=float(best.metrics["mean_speed"][0]),
        cost_of_transport=transport if np.isfinite(transport) else None,
        seconds=round(seconds, 1),
    )
    return record, best.choices[:, 0]


def check(archive: Archive) -> list[str]:
    """Repeats the motions of all records; returns what is not as it stands there, one line each."""
    stale = []
    for key, record in archive.records.items():
        metrics = repeat(record.problem, archive.choices[key]).metrics
        transport = float(metrics["cost_of_transport"][0])
        now = (float(metrics["mean_speed"][0]), transport if np.isfinite(transport) else None)
        if now != (record.mean_speed, record.cost_of_transport) or metrics["failed"][0]:
            stale.append(f"{key}: {record.mean_speed} cm/s at {record.cost_of_transport} on file, {now} now")
    return stale


def describe(problem: Problem) -> str:
    """A problem in a line."""
    extras = [
        f"{problem.energy_weight:g} cm/J" if problem.energy_weight else "",
        f"margin {problem.margin:g} N" if problem.margin else "",
    ]
    return ", ".join(
        [f"M={problem.M:g}", f"mu={problem.mu:g}", f"hold {1e3 * problem.hold:g} ms", *filter(None, extras)]
    )


def solve(problem: Problem, archive: Archive, name: str) -> None:
    """Solves a problem and files it."""
    began = perf_counter()
    live = sys.stderr.isatty()

    def tell(line: str) -> None:
        if live:
            print(f"\r\033[K{name}: {line}", end="", file=sys.stderr, flush=True)

    levels = optimise(problem, grids_of(problem), tell)
    seconds = perf_counter() - began
    record, choices = record_of(problem, levels, seconds)
    policy = problem.energy_weight == 0.0 and problem.hold == CONTROL_DT
    archive.add(record, choices, levels[0].solution if policy else None)
    archive.save()
    gains = ", ".join(f"{gain:.3f}" for gain in record.gains)
    print(f"\r{name}: {record.mean_speed:.2f} cm/s over 33 s, gains {gains} cm/s, {seconds:.0f} s", flush=True)
