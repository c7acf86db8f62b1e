"""The archive of the results: trajectories with their speeds, and values of the coarse grids.

Each archived speed is that of a trajectory, whose torques, repeated from rest, give it on every
machine.
"""

import json
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
    PENDULUM,
    Problem,
    Trajectory,
    corner_weights,
    plant_problems,
    repeat,
    run_episodes,
)
from baselines.dynamic_programming.solver import GRIDS, STARTS, Solution
from capsule_gym.evaluation.optimum import ARCHIVE, ARRAYS, FOLDER, GRID
from capsule_gym.evaluation.optimum import optimal_speed as optimal_speed
from capsule_gym.evaluation.sets import load_set
from capsule_gym.files import load_arrays, replacing, write_atomically
from capsule_gym.tasks.task import CONTROL_DT, START_THETA

# cm: step of the stored values, larger if two bytes cannot count the steps; a control interval
# earns half a cm.
RESOLUTION = 0.005
MAX_STEPS = 65535
# Evaluation sets whose plants are solved themselves.
SETS = ("paper", "wide")
# Fields of a result, and metrics of its trajectory.
PERFORMANCE = ("mean_speed", "cost_of_transport")
FAILURE = 1e9  # deduction from the reward of a trajectory that fails


@dataclass(frozen=True, kw_only=True)
class Result(Problem):
    """The solution of one problem; the archived trajectory is the best of all grids."""

    grids: list[list[int]]  # nodes along theta, s and w, from coarse to fine
    gains: list[float]  # mean reward of the Markov chain on each grid, cm/s
    steady: list[float]  # mean speed of each grid's trajectory over whole cycles, cm/s
    mean_speed: float  # of the archived trajectory over 33 s from rest, cm/s
    cost_of_transport: float  # of the archived trajectory

    def content(self) -> dict[str, Any]:
        """The fields but the constants of the pendulum and the motor, which are nominal."""
        nominal = (*PENDULUM, "motor_friction")
        return {name: value for name, value in asdict(self).items() if name not in nominal}


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
        """Solves one problem per iteration and adds its result."""
        for n, problem in enumerate(problems):
            print(f"{n + 1}/{len(problems)} {problem} ..", flush=True)
            began = perf_counter()
            # A solution and its trajectory for each grid, the coarsest first.
            solved = solver.solve_on_grids(problem, _shapes(problem))
            self._add_result(problem, solved)
            # The policies look ahead with the values of the speed problems.
            if problem.energy_weight == 0.0 and problem.control_dt == CONTROL_DT:
                coarse_solution, _ = solved[0]
                self._add_values(problem, coarse_solution)
            speed = self.results[problem.key].mean_speed
            print(f"{speed:.2f} cm/s, {perf_counter() - began:.0f} s", flush=True)
            yield

    def _add_result(self, problem: Problem, solved: list[tuple[Solution, Trajectory]]) -> None:
        """Adds the results of all grids, with the trajectory of the largest reward."""
        solutions = [solution for solution, _ in solved]
        runs = [trajectory for _, trajectory in solved]
        best = max(runs, key=lambda run: _reward(problem, run))
        self.arrays[f"{problem.key} torques"] = best.choices[:, 0]
        gains = [solution.gain for solution in solutions]
        steady = [run.steady_speed(problem.control_dt) for run in runs]
        self.results[problem.key] = Result(
            **asdict(problem),
            grids=[list(solution.grid.shape) for solution in solutions],
            gains=[round(gain, 4) for gain in gains],
            steady=[round(speed, 4) for speed in steady],
            **_performance(best),
        )

    def _add_values(self, problem: Problem, solution: Solution) -> None:
        """Stores values as steps of `RESOLUTION`.

        Rounded differences along all axes, modulo 65536, compress better.
        """
        low = float(solution.values.min())
        step = max(RESOLUTION, (float(solution.values.max()) - low) / MAX_STEPS)
        steps = np.round((solution.values - low) / step).astype(np.uint16)
        for axis in range(steps.ndim):
            steps = np.diff(steps, axis=axis, prepend=np.uint16(0))
        self.arrays[f"{problem.key} differences"] = steps
        limits = (*solution.grid.y, *solution.grid.w)
        numbers = [low, step, *limits, solution.curvature, solution.gain]
        self.arrays[f"{problem.key} numbers"] = np.array(numbers)

    def solution(self, problem: Problem) -> Solution:
        """The stored values of a problem.

        They exist for every plant of the grids and for the margin.
        """
        steps = self.arrays[f"{problem.key} differences"]
        for axis in range(steps.ndim):
            steps = np.cumsum(steps, axis=axis, dtype=np.uint16)
        numbers = self.arrays[f"{problem.key} numbers"].tolist()
        low, step, low_y, high_y, low_w, high_w, curvature, gain = numbers
        values = (low + step * steps).astype(np.float32)
        grid = Grid(steps.shape, (low_y, high_y), (low_w, high_w), problem.q)
        return Solution(problem, grid, values, curvature, gain)

    @property
    def plant_speeds(self) -> dict[tuple[float, float], float]:
        """Mean speeds, cm/s, of the plants of evaluation sets by M, kg, and mu."""
        if "plants" not in self.arrays:
            return {}
        return {(M, mu): speed for M, mu, speed in self.arrays["plants"].tolist()}

    def repeat(self, problem: Problem) -> Trajectory:
        """Repeats the trajectory of a problem."""
        return repeat(problem, self.arrays[f"{problem.key} torques"])

    def check(self) -> list[str]:
        """Repeats all trajectories; returns one line for each difference from the archive."""
        stale = []
        for key, result in self.results.items():
            filed = {name: getattr(result, name) for name in PERFORMANCE}
            now = _performance(self.repeat(result))
            if now != filed:
                stale.append(f"{key}: {filed} on file, {now} now")
        for plant, speed in self._repeat_plants():
            if plant[2] != speed:
                stale.append(f"M, mu, cm/s: {plant} on file, {speed} cm/s now")
        return stale

    def _repeat_plants(self) -> Iterator[tuple[list[float], float]]:
        """The plants of the sets with the speed on file, and the speed of their torques."""
        if "plants" not in self.arrays:
            return
        plants = self.arrays["plants"]
        torques = self.arrays["plants torques"]
        count, steps = torques.shape
        starts = np.full(count, START_THETA)

        def choose(step: int, states: np.ndarray) -> np.ndarray:
            return torques[:, step]

        run = run_episodes(Problem(), starts, steps, choose, plants[:, :2])
        yield from zip(plants.tolist(), run.metrics["mean_speed"].tolist(), strict=True)

    def save(self, folder: Path = FOLDER) -> None:
        """Writes the archive, each file atomically.

        The results are written last, so that no result lacks its arrays.
        """
        folder.mkdir(parents=True, exist_ok=True)
        ordered: dict[str, Any] = dict(sorted(self.arrays.items()))
        with replacing(folder / ARRAYS) as temporary:
            np.savez_compressed(temporary, **ordered)
        results = [self.results[key].content() for key in sorted(self.results)]
        lines = ",\n".join(f"  {json.dumps(result)}" for result in results)
        write_atomically(folder / ARCHIVE, f'{{\n "results": [\n{lines}\n ]\n}}\n')


def load_archive(folder: Path = FOLDER) -> Archive:
    """Reads the archive of a folder, or returns an empty one.

    Raises:
        ValueError: if a file is malformed.
    """
    if not (folder / ARCHIVE).is_file():
        return Archive()
    try:
        content = json.loads((folder / ARCHIVE).read_text(encoding="utf-8"))
        results = [Result(**fields) for fields in content["results"]]
        arrays = load_arrays(folder / ARRAYS)
        return Archive({result.key: result for result in results}, arrays)
    # The JSON may contain anything.
    except Exception as error:
        message = f"{folder} must hold an archive for `python -m baselines.dynamic_programming`"
        raise ValueError(f"{message}, got {type(error).__name__}: {error}") from error


def _shapes(problem: Problem) -> tuple[tuple[int, int, int], ...]:
    """The grids of a problem: all for the main problem, fewer for the many others."""
    if problem.control_dt != CONTROL_DT:
        return GRIDS[:3]
    return GRIDS if problem == Problem() else GRIDS[:2]


def _reward(problem: Problem, trajectory: Trajectory) -> float:
    """The reward of the first episode, cm, less a deduction if it fails."""
    distance, energy, failed = (
        float(trajectory.metrics[name][0]) for name in ("distance", "energy", "failed")
    )
    return 100.0 * distance - problem.energy_weight * energy - FAILURE * failed


def _performance(trajectory: Trajectory) -> dict[str, float]:
    """Mean speed, cm/s, and cost of transport of the first episode."""
    return {name: float(trajectory.metrics[name][0]) for name in PERFORMANCE}


@cache
def known_results() -> Archive:
    """The archived results, read once."""
    return load_archive()


def set_plants() -> list[tuple[float, float]]:
    """M in kg and mu of all plants of `SETS`, without repetitions."""
    plants = [(plant.M, plant.mu) for name in SETS for plant in load_set(name).plants]
    return list(dict.fromkeys(plants))


def solve_near(
    problem: Problem,
    archive: Archive,
    shape: tuple[int, int, int] = GRIDS[0],
    room: float = 0.0,
) -> Solution:
    """Solves a plant over the ranges of the plants of `GRID` around it, from the nearest's values.

    Args:
        problem: the plant's problem. Outside of `GRID` the plants at its edge are taken.
        archive: the archive with the solutions of `GRID`.
        shape: nodes along theta, s and w.
        room: share by which the ranges are extended, for a plant with constants of its own.
    """
    corners, along_M, along_mu = GRID.cell(problem.M, problem.mu)
    near = [archive.solution(plant_problems(GRID)[corner]) for corner in corners]
    weights = corner_weights(along_M, along_mu)
    y = _union([solution.grid.y for solution in near], room)
    w = _union([solution.grid.w for solution in near], room)
    grid = Grid(solver.divide_nodes(shape, y, w), y, w, problem.q)
    weighted = zip(weights.tolist(), near, strict=True)
    curvature = sum(weight * solution.curvature for weight, solution in weighted)
    nearest = near[int(weights.argmax())]
    return solver.solve(problem, grid, curvature=curvature, start=nearest)


def solve_plant(
    problem: Problem, archive: Archive, shape: tuple[int, int, int] = GRIDS[0]
) -> Trajectory:
    """The trajectory of a plant within `GRID`."""
    solution = solve_near(problem, archive, shape)
    return solver.run_policy(solution, STARTS[:1], final=solver.final_solutions(solution))


def _union(ranges: Sequence[tuple[float, float]], room: float) -> tuple[float, float]:
    """The range that contains all ranges, longer by a share at both ends."""
    lows, highs = zip(*ranges, strict=True)
    low, high = min(lows), max(highs)
    return low - room * abs(low), high + room * abs(high)


def solve_plants(archive: Archive, missing: Sequence[tuple[float, float]]) -> Iterator[None]:
    """Solves plants, M in kg and mu, and adds them to an archive with the values of `GRID`."""
    for n, (M, mu) in enumerate(missing):
        trajectory = solve_plant(Problem(M=M, mu=mu), archive)
        plant = [M, mu, *trajectory.metrics["mean_speed"]]
        for name, row in (("plants", plant), ("plants torques", trajectory.choices[:, 0])):
            archive.arrays[name] = np.array([*archive.arrays.get(name, ()), row])
        print(f"{n + 1}/{len(missing)} plants of the sets", flush=True)
        yield


def optimal_front() -> list[tuple[float, float]]:
    """The undominated costs of transport and mean speeds (cm/s) of the energy weights.

    They are those of the nominal plant, slowest first.
    """
    results = known_results().results
    found = [results[Problem(energy_weight=weight).key] for weight in (0.0, *ENERGY_WEIGHTS)]
    front = []
    for result in found:
        faster = [other for other in found if other.mean_speed > result.mean_speed]
        if all(other.cost_of_transport > result.cost_of_transport for other in faster):
            front.append((result.cost_of_transport, result.mean_speed))
    return sorted(front, key=lambda point: point[1])


def extrapolated(result: Result) -> str:
    """The limit of the gains on ever finer grids, cm/s, for errors of second and of first order."""
    before, last = result.gains[-2:]
    coarse, fine = result.grids[-2:]
    ratio = (fine[0] - 1) / (coarse[0] - 1)
    second = last + (last - before) / (ratio**2 - 1.0)
    first = last + (last - before) / (ratio - 1.0)
    return f"{second:.2f} to {first:.2f}"
