"""The archive of the results: trajectories, and values of the coarse grids.

A speed on file is that of a trajectory: `data/arrays.npz` holds its torques, one per control interval, and repeating
them from rest gives the same speed on every machine. `gains` are what the solver found on its grids.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from baselines.archive import PLANTS, between_plants, read_archive, write_archive
from baselines.dynamic_programming import FOLDER
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.problem import Problem
from baselines.dynamic_programming.refinement import GridResult
from baselines.dynamic_programming.solver import Solution
from baselines.dynamic_programming.trajectory import repeat

# cm: values are stored in steps of this size, or of the size that two bytes can count; an interval earns half a cm.
RESOLUTION = 0.005
MAX_STEPS = 65535


@dataclass(frozen=True, kw_only=True)
class Result:
    """What is known of one problem.

    Attributes:
        M: mass of the platform, kg.
        mu: friction coefficient.
        energy_weight: cm/J.
        control_dt: control interval, s.
        margin: see `Problem`, N.
        grids: nodes along theta, s and w of every grid, from coarse to fine.
        gains: mean reward of the Markov chain on each, cm/s.
        steady: mean speed of the trajectory on each over whole cycles, cm/s.
        mean_speed: of the trajectory on file, the best of all grids', over 33 s from rest, cm/s.
        cost_of_transport: of that trajectory; None without forward progress.
        seconds: run time of the solver.
    """

    M: float
    mu: float
    energy_weight: float
    control_dt: float
    margin: float
    grids: tuple[tuple[int, int, int], ...]
    gains: tuple[float, ...]
    steady: tuple[float, ...]
    mean_speed: float
    cost_of_transport: float | None
    seconds: float

    @property
    def problem(self) -> Problem:
        """What was optimised."""
        names = ("M", "mu", "energy_weight", "control_dt", "margin")
        return Problem(**{name: getattr(self, name) for name in names})


def key_of(problem: Problem) -> str:
    """The name under which a problem is stored; the capsule's constants are the default ones."""
    numbers = (problem.M, problem.mu, problem.energy_weight, problem.control_dt, problem.margin)
    return " ".join(f"{number:g}" for number in numbers)


@dataclass
class Archive:
    """The results with their arrays.

    Attributes:
        results: by key.
        arrays: by key and kind: `torques` of the trajectory as indices of `trajectory.ACTIONS`, uint8; the values'
            `differences` and `numbers`.
    """

    results: dict[str, Result] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, problem: Problem, results: list[GridResult], seconds: float, *, values: bool = True) -> Result:
        """Adds a problem's result, in the place of an older one, with the trajectory of the largest reward.

        Args:
            problem: what was optimised.
            results: on its grids, from coarse to fine.
            seconds: run time of the solver.
            values: whether the values of the coarsest grid are stored.
        """

        def reward(result: GridResult) -> float:
            metrics = result.trajectory.metrics
            value = 100.0 * metrics["distance"][0] - problem.energy_weight * metrics["energy"][0]
            return float(value) - 1e9 * float(metrics["failed"][0])

        best = max(results, key=reward).trajectory
        transport = float(best.metrics["cost_of_transport"][0])
        result = Result(
            M=problem.M,
            mu=problem.mu,
            energy_weight=problem.energy_weight,
            control_dt=problem.control_dt,
            margin=problem.margin,
            grids=tuple(each.solution.grid.shape for each in results),
            gains=tuple(round(each.solution.gain, 4) for each in results),
            steady=tuple(round(each.trajectory.steady_speed(problem.control_dt), 4) for each in results),
            mean_speed=float(best.metrics["mean_speed"][0]),
            cost_of_transport=transport if np.isfinite(transport) else None,
            seconds=round(seconds, 1),
        )
        key = key_of(problem)
        self.results[key] = result
        self.arrays[f"{key} torques"] = best.choices[:, 0]
        for kind in ("differences", "numbers"):
            self.arrays.pop(f"{key} {kind}", None)
        if values:
            self._add_values(key, results[0].solution)
        return result

    def _add_values(self, key: str, solution: Solution) -> None:
        """Stores values rounded to steps; of these differences along all axes, modulo 65536, which compress better."""
        low, high = float(solution.values.min()), float(solution.values.max())
        step = max(RESOLUTION, (high - low) / MAX_STEPS)
        steps = np.round((solution.values - low) / step).astype(np.uint16)
        for axis in range(steps.ndim):
            steps = np.diff(steps, axis=axis, prepend=np.uint16(0))
        self.arrays[f"{key} differences"] = steps
        numbers = [low, step, *solution.grid.y, *solution.grid.w, solution.curvature, solution.gain]
        self.arrays[f"{key} numbers"] = np.array(numbers)

    def choices(self, problem: Problem) -> np.ndarray:
        """The torques of a problem's trajectory, as indices of `trajectory.ACTIONS`."""
        return self.arrays[f"{key_of(problem)} torques"]

    def solution(self, problem: Problem) -> Solution:
        """The stored values of a problem.

        Raises:
            ValueError: if there are none.
        """
        try:
            steps, numbers = (self.arrays[f"{key_of(problem)} {kind}"] for kind in ("differences", "numbers"))
        except KeyError:
            raise ValueError(f"the archive holds no values of {problem}") from None
        low, step, *limits, curvature, gain = numbers.tolist()
        for axis in range(steps.ndim):
            steps = np.cumsum(steps, axis=axis, dtype=np.uint16)
        grid = Grid(steps.shape, (limits[0], limits[1]), (limits[2], limits[3]), problem.M)
        return Solution(problem, grid, (low + step * steps).astype(np.float32), curvature, gain, 0.0)

    def check(self) -> list[str]:
        """Repeats all trajectories; returns what differs from the archive, one line each."""
        stale = []
        for key, result in self.results.items():
            metrics = repeat(result.problem, self.choices(result.problem)).metrics
            transport = float(metrics["cost_of_transport"][0])
            now = (float(metrics["mean_speed"][0]), transport if np.isfinite(transport) else None)
            if now != (result.mean_speed, result.cost_of_transport) or metrics["failed"][0]:
                stale.append(f"{key}: {result.mean_speed} cm/s at {result.cost_of_transport} on file, {now} now")
        return stale

    def save(self, folder: Path = FOLDER) -> None:
        """Writes the archive."""
        results = sorted(self.results.values(), key=lambda r: (r.margin, r.control_dt, r.energy_weight, r.M, r.mu))
        write_archive(folder, {"results": [asdict(result) for result in results]}, self.arrays)


def load_archive(folder: Path = FOLDER) -> Archive:
    """Reads the archive of a folder; an empty one where there is none.

    Raises:
        ValueError: if a file is malformed.
    """
    return read_archive(folder, "python -m baselines.dynamic_programming", _build, Archive)


def _build(content: dict[str, Any], arrays: dict[str, np.ndarray]) -> Archive:
    """The archive of a JSON object and its arrays."""
    results = [Result(**fields) for fields in content["results"]]
    for result in results:
        torques = arrays[f"{key_of(result.problem)} torques"]
        if torques.dtype != np.uint8 or torques.ndim != 1:
            raise ValueError(f"the torques of {key_of(result.problem)!r} must be a list of bytes")
    return Archive({key_of(result.problem): result for result in results}, arrays)


@lru_cache(maxsize=1)
def known_results() -> Archive:
    """The committed results, read once.

    Raises:
        ValueError: if the data lacks a plant of the grid.
    """
    archive = load_archive()
    missing = [plant for plant in PLANTS if key_of(Problem(M=plant[0], mu=plant[1])) not in archive.results]
    if missing:
        raise ValueError(f"{FOLDER} must hold every plant of the grid, lacks {missing}")
    return archive


@lru_cache(maxsize=1)
def speeds() -> dict[tuple[float, float], float]:
    """The speed on every plant of the grid, cm/s."""
    results = known_results().results
    return {(M, mu): results[key_of(Problem(M=M, mu=mu))].mean_speed for M, mu in PLANTS}


def optimal_speed(M: float, mu: float) -> float:
    """The mean speed of dynamic programming from rest over 33 s, torque within 1.5 N m every 20 ms, in cm/s.

    Linear in M and in log(mu) between the plants of the grid, which can be off by some percent. At the plants it is the
    speed of a trajectory that was found, not an upper bound: a policy may exceed it a little.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.

    Raises:
        ValueError: if the plant lies outside the grid.
    """
    return between_plants(speeds(), M, mu)


def optimal_front() -> list[tuple[float, float]]:
    """Cost of transport and mean speed (cm/s) on the nominal plant, one point for every energy weight, slowest first.

    Points that another one beats in both are left out.
    """
    found = [
        (result.cost_of_transport, result.mean_speed)
        for result in known_results().results.values()
        if result.problem == Problem(energy_weight=result.energy_weight) and result.cost_of_transport is not None
    ]
    undominated = [(cost, speed) for cost, speed in found if not any(c <= cost and s > speed for c, s in found)]
    return sorted(undominated, key=lambda point: point[1])
