"""The archive of the results: trajectories with their speeds, and values of the coarse grids.

Each archived speed is that of a trajectory, whose torques, repeated from rest, give it on every
machine.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from baselines.dynamic_programming import solver
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.problem import (
    ENERGY_WEIGHTS,
    Problem,
    Trajectory,
    plant_problems,
    repeat,
    run_episodes,
)
from baselines.dynamic_programming.solver import GRIDS, STARTS, Solution
from capsule_gym.evaluation.optimum import ARCHIVE, ARRAYS, FOLDER, GRID
from capsule_gym.evaluation.optimum import optimal_speed as optimal_speed
from capsule_gym.evaluation.sets import load_set
from capsule_gym.files import replacing, write_atomically
from capsule_gym.tasks.task import CONTROL_DT, START_THETA

# cm: step of the stored values, larger if two bytes cannot count the steps; a control interval
# earns half a cm.
RESOLUTION, MAX_STEPS = 0.005, 65535
# Evaluation sets whose plants are solved themselves.
SETS = ("paper", "wide")
# What reading a malformed archive of numpy or JSON file raises.
UNREADABLE = (
    *(EOFError, IndexError, KeyError, MemoryError, OSError, RecursionError, TypeError, ValueError),
    *(zipfile.BadZipFile, zlib.error),
)


@dataclass(frozen=True, kw_only=True)
class Result(Problem):
    """The solution of one problem; the archived trajectory is the best of all grids."""

    grids: list[list[int]]  # nodes along theta, s and w, from coarse to fine
    gains: list[float]  # mean reward of the Markov chain on each grid, cm/s
    steady: list[float]  # mean speed of each grid's trajectory over whole cycles, cm/s
    mean_speed: float  # of the archived trajectory over 33 s from rest, cm/s
    cost_of_transport: float  # of the archived trajectory


@dataclass
class Archive:
    """The results by key, and their arrays by key and kind.

    The kinds are `torques` of the trajectory (indices of `ACTIONS`, uint8), `differences` and
    `numbers` of the values; for plants of evaluation sets `plants` with M, mu and speed, and
    `plants torques`, shape (plants, steps).
    """

    results: dict[str, Result] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def solve(self, problems: Sequence[Problem]) -> Iterator[None]:
        """Solves one problem per iteration and adds its result, with the trajectory of the largest
        reward.
        """
        for n, problem in enumerate(problems):
            print(f"{n + 1}/{len(problems)} {problem} ..", flush=True)
            began, own_interval = perf_counter(), problem.control_dt == CONTROL_DT
            solved = solver.solve_on_grids(
                problem, GRIDS[: (4 if problem == Problem() else 2) if own_interval else 3]
            )
            runs = [trajectory for _, trajectory in solved]
            distance, energy, failed = (
                np.array([run.metrics[key][0] for run in runs])
                for key in ("distance", "energy", "failed")
            )
            best = runs[
                int((100.0 * distance - problem.energy_weight * energy - 1e9 * failed).argmax())
            ]
            self.results[problem.key] = Result(
                **asdict(problem),
                grids=[list(solution.grid.shape) for solution, _ in solved],
                gains=[round(solution.gain, 4) for solution, _ in solved],
                steady=[round(run.steady_speed(problem.control_dt), 4) for run in runs],
                **_performance(best),
            )
            self.arrays[f"{problem.key} torques"] = best.choices[:, 0]
            # The policies look ahead with the values of the speed problems. Rounded differences
            # along all axes, modulo 65536, compress better.
            if problem.energy_weight == 0.0 and own_interval:
                solution = solved[0][0]
                low, high = float(solution.values.min()), float(solution.values.max())
                step = max(RESOLUTION, (high - low) / MAX_STEPS)
                steps = np.round((solution.values - low) / step).astype(np.uint16)
                for axis in range(steps.ndim):
                    steps = np.diff(steps, axis=axis, prepend=np.uint16(0))
                self.arrays[f"{problem.key} differences"] = steps
                numbers = [
                    low,
                    step,
                    *solution.grid.y,
                    *solution.grid.w,
                    solution.curvature,
                    solution.gain,
                ]
                self.arrays[f"{problem.key} numbers"] = np.array(numbers)
            print(
                f"{self.results[problem.key].mean_speed:.2f} cm/s, {perf_counter() - began:.0f} s",
                flush=True,
            )
            yield

    def solution(self, problem: Problem) -> Solution:
        """The stored values of a problem; they exist for every plant of the grids and for the
        margin.
        """
        steps, numbers = (
            self.arrays[f"{problem.key} {kind}"] for kind in ("differences", "numbers")
        )
        low, step, *limits, curvature, gain = numbers.tolist()
        for axis in range(steps.ndim):
            steps = np.cumsum(steps, axis=axis, dtype=np.uint16)
        grid = Grid(steps.shape, (limits[0], limits[1]), (limits[2], limits[3]), problem.M)
        return Solution(problem, grid, (low + step * steps).astype(np.float32), curvature, gain)

    @property
    def plant_speeds(self) -> dict[tuple[float, float], float]:
        """Mean speeds, cm/s, of the plants of evaluation sets by M, kg, and mu."""
        return {
            (M, mu): speed for M, mu, speed in self.arrays.get("plants", np.empty((0, 3))).tolist()
        }

    def repeat(self, problem: Problem) -> Trajectory:
        """Repeats the trajectory of a problem."""
        return repeat(problem, self.arrays[f"{problem.key} torques"])

    def check(self) -> list[str]:
        """Repeats all trajectories; returns one line for each difference from the archive."""
        stale = []
        for key, result in self.results.items():
            filed = {name: getattr(result, name) for name in ("mean_speed", "cost_of_transport")}
            if (now := _performance(self.repeat(result))) != filed:
                stale.append(f"{key}: {filed} on file, {now} now")
        if "plants" in self.arrays:
            plants, torques = self.arrays["plants"], self.arrays["plants torques"]
            thetas = np.full(len(plants), START_THETA)
            run = run_episodes(
                Problem(),
                thetas,
                torques.shape[1],
                lambda step, states: torques[:, step],
                plants[:, :2],
            )
            found = zip(plants.tolist(), run.metrics["mean_speed"].tolist(), strict=True)
            stale += [
                f"M, mu, cm/s: {filed} on file, {now} cm/s now"
                for filed, now in found
                if filed[2] != now
            ]
        return stale

    def save(self, folder: Path = FOLDER) -> None:
        """Writes the archive, each file atomically and the results last, so that no result lacks
        its arrays.
        """
        folder.mkdir(parents=True, exist_ok=True)
        ordered: dict[str, Any] = dict(sorted(self.arrays.items()))
        with replacing(folder / ARRAYS) as temporary:
            np.savez_compressed(temporary, **ordered)
        lines = ",\n".join(
            f"  {json.dumps(asdict(result))}" for _, result in sorted(self.results.items())
        )
        write_atomically(folder / ARCHIVE, f'{{\n "results": [\n{lines}\n ]\n}}\n')


def load_archive(folder: Path = FOLDER) -> Archive:
    """Reads the archive of a folder, or returns an empty one; a malformed file raises a
    ValueError.
    """
    if not (folder / ARCHIVE).is_file():
        return Archive()
    try:
        content = json.loads((folder / ARCHIVE).read_text(encoding="utf-8"))["results"]
        results = [Result(**fields) for fields in content]
        # Read from memory, since numpy does not close an invalid file.
        with np.load(io.BytesIO((folder / ARRAYS).read_bytes()), allow_pickle=False) as found:
            return Archive({result.key: result for result in results}, dict(found))
    except UNREADABLE as error:
        message = f"{folder} must hold an archive for `python -m baselines.dynamic_programming`"
        raise ValueError(f"{message}, got {type(error).__name__}: {error}") from error


def _performance(trajectory: Trajectory) -> dict[str, float]:
    """Mean speed, cm/s, and cost of transport of the first episode."""
    return {
        name: float(trajectory.metrics[name][0]) for name in ("mean_speed", "cost_of_transport")
    }


@cache
def known_results() -> Archive:
    """The archived results, read once."""
    return load_archive()


def set_plants() -> list[tuple[float, float]]:
    """M in kg and mu of all plants of `SETS`, without repetitions."""
    return list(
        dict.fromkeys((plant.M, plant.mu) for name in SETS for plant in load_set(name).plants)
    )


def solve_plant(
    problem: Problem, archive: Archive, shape: tuple[int, int, int] = GRIDS[0]
) -> Trajectory:
    """The trajectory of a plant within `GRID`, solved over the ranges and from the values of the
    plants around it.
    """
    corners, along_M, along_mu = GRID.cell(problem.M, problem.mu)
    near = [archive.solution(plant_problems(GRID)[corner]) for corner in corners]
    weights = np.outer([1.0 - along_M, along_M], [1.0 - along_mu, along_mu]).ravel()
    limits = np.array([[solution.grid.y, solution.grid.w] for solution in near])
    y, w = zip(
        limits[..., 0].min(axis=0).tolist(), limits[..., 1].max(axis=0).tolist(), strict=True
    )
    curvature = sum(
        weight * solution.curvature for weight, solution in zip(weights.tolist(), near, strict=True)
    )
    grid = Grid(solver.divide_nodes(shape, y, w), y, w, problem.M)
    solution = solver.solve(problem, grid, curvature=curvature, start=near[int(weights.argmax())])
    return solver.run_policy(solution, STARTS[:1], final=solver.final_solutions(solution))


def solve_plants(archive: Archive, missing: Sequence[tuple[float, float]]) -> Iterator[None]:
    """Solves plants, M in kg and mu, and adds them to an archive with the values of `GRID`."""
    for n, (M, mu) in enumerate(missing):
        trajectory = solve_plant(Problem(M=M, mu=mu), archive)
        rows = {
            "plants": [M, mu, *trajectory.metrics["mean_speed"]],
            "plants torques": trajectory.choices[:, 0],
        }
        for name, row in rows.items():
            archive.arrays[name] = np.array([*archive.arrays.get(name, ()), row])
        print(f"{n + 1}/{len(missing)} plants of the sets", flush=True)
        yield


def optimal_front() -> list[tuple[float, float]]:
    """The undominated costs of transport and mean speeds (cm/s) of the energy weights, nominal
    plant, slowest first.
    """
    results = known_results().results
    own = [results[Problem(energy_weight=weight).key] for weight in (0.0, *ENERGY_WEIGHTS)]
    found = [(each.cost_of_transport, each.mean_speed) for each in own]
    undominated = [
        (cost, speed) for cost, speed in found if not any(c <= cost and s > speed for c, s in found)
    ]
    return sorted(undominated, key=lambda point: point[1])


def extrapolated(result: Result) -> str:
    """The limit of the gains on ever finer grids, cm/s, for errors of second and of first order."""
    ratio = (result.grids[-1][0] - 1) / (result.grids[-2][0] - 1)
    before, last = result.gains[-2:]
    return " to ".join(f"{last + (last - before) / (ratio**order - 1.0):.2f}" for order in (2, 1))
