"""What is kept of the optima: `data/optima.json`, the torques of their motions and the values of their coarse grids.

A record is a demonstrated speed: `data/motions.npz` holds the torques of the motion, hold by hold, and repeating them
from rest gives the speed, on every machine the same. `gains` are what the dynamic programming found on its grids.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from baselines.gaits.archive import GRID_M, GRID_MU, PLANTS, between_plants
from baselines.optimum import FOLDER
from baselines.optimum.grid import Grid
from baselines.optimum.solver import Problem, Solution
from capsule_gym.files import replacing, write_atomically

RECORDS, MOTIONS, VALUES = "optima.json", "motions.npz", "values.npz"
# cm: in steps of this values are kept, or of what two bytes can count; a hold earns half a centimetre.
RESOLUTION = 0.005
MOST_STEPS = 65535


@dataclass(frozen=True, kw_only=True)
class Record:
    """What is known of one problem.

    Attributes:
        M: mass of the platform, kg.
        mu: friction coefficient.
        energy_weight: cost of a joule, cm.
        hold: s.
        margin: see `Problem`, N.
        grids: nodes along theta, s and w of every grid, from coarse to fine.
        gains: mean reward of the Markov chain on each, cm/s.
        steady: mean speed of the motion on each over whole cycles, cm/s.
        mean_speed: of the motion kept, the best of all grids', over 33 s from rest, cm/s.
        cost_of_transport: of that motion; None without forward progress.
        seconds: that the computation took.
    """

    M: float
    mu: float
    energy_weight: float
    hold: float
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
        return Problem(M=self.M, mu=self.mu, energy_weight=self.energy_weight, hold=self.hold, margin=self.margin)

    @property
    def key(self) -> str:
        """Its name in the other files."""
        return key_of(self.problem)

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> Record:
        """The record from its JSON object."""
        tuples = {name: tuple(fields[name]) for name in ("gains", "steady")}
        return cls(**{**fields, **tuples, "grids": tuple(tuple(shape) for shape in fields["grids"])})


def key_of(problem: Problem) -> str:
    """The name of a problem of the capsule's own constants and torque limit."""
    numbers = (problem.M, problem.mu, problem.energy_weight, problem.hold, problem.margin)
    return " ".join(f"{number:g}" for number in numbers)


class Archive:
    """The records with their motions and values.

    Args:
        folder: of the files; what is not there is empty.

    Raises:
        ValueError: if a file is malformed.

    Attributes:
        records: by key.
        choices: torques of the motion of every record, as indices of `motion.ACTIONS`, uint8.
    """

    def __init__(self, folder: Path = FOLDER) -> None:
        self.folder = folder
        self.records: dict[str, Record] = {}
        path = folder / RECORDS
        try:
            if path.is_file():
                found = [Record.from_dict(fields) for fields in json.loads(path.read_text(encoding="utf-8"))]
                self.records = {record.key: record for record in found}
            self.choices = _load(folder / MOTIONS)
            self._values = _load(folder / VALUES)
            for key in self.records:
                if self.choices[key].dtype != np.uint8 or self.choices[key].ndim != 1:
                    raise ValueError(f"the motion {key!r} is no list of bytes")
        except (KeyError, TypeError, ValueError, OSError) as error:
            raise ValueError(
                f"{folder} must hold what `python -m baselines.optimum` writes, got {type(error).__name__}: {error}"
            ) from error

    def add(self, record: Record, choices: np.ndarray, solution: Solution | None) -> None:
        """Takes a record in the place of an older one of the same problem."""
        self.records[record.key] = record
        self.choices[record.key] = choices
        for name in _VALUE_NAMES:
            self._values.pop(f"{record.key} {name}", None)
        if solution is not None:
            low, high = float(solution.values.min()), float(solution.values.max())
            step = max(RESOLUTION, (high - low) / MOST_STEPS)
            entries = (
                _differences(np.round((solution.values - low) / step).astype(np.uint16)),
                np.array([low, step, *solution.grid.y, *solution.grid.w, solution.curvature, solution.gain]),
            )
            self._values |= {f"{record.key} {name}": e for name, e in zip(_VALUE_NAMES, entries, strict=True)}

    def solution(self, problem: Problem) -> Solution:
        """The coarse solution that is kept of a problem.

        Raises:
            ValueError: if there is none.
        """
        key = key_of(problem)
        try:
            differences, numbers = (self._values[f"{key} {name}"] for name in _VALUE_NAMES)
        except KeyError:
            raise ValueError(f"{self.folder / VALUES} holds no values of {problem}") from None
        low, step, *box, curvature, gain = numbers.tolist()
        steps = _sums(differences)
        grid = Grid(steps.shape, (box[0], box[1]), (box[2], box[3]), problem.M, problem.capsule)
        values = (low + step * steps).astype(np.float32)
        return Solution(problem, grid, values, curvature, gain, 0.0)

    def save(self) -> None:
        """Writes the files, each whole or not at all; the records last, so that none lacks its motion."""
        for name, arrays in ((MOTIONS, self.choices), (VALUES, self._values)):
            ordered_arrays: dict[str, Any] = {key: arrays[key] for key in sorted(arrays)}
            with replacing(self.folder / name) as temporary:
                np.savez_compressed(temporary, **ordered_arrays)
        ordered = sorted(self.records.values(), key=lambda r: (r.margin, r.hold, r.energy_weight, r.M, r.mu))
        text = ",\n".join(" " + json.dumps(asdict(record)) for record in ordered)
        write_atomically(self.folder / RECORDS, f"[\n{text}\n]\n")


_VALUE_NAMES = ("differences", "numbers")


def _differences(steps: np.ndarray) -> np.ndarray:
    """Differences along all axes, modulo what two bytes can count: they are packed to two thirds."""
    for axis in range(steps.ndim):
        steps = np.diff(steps, axis=axis, prepend=np.uint16(0))
    return steps


def _sums(differences: np.ndarray) -> np.ndarray:
    """The steps from their differences."""
    for axis in range(differences.ndim):
        differences = np.cumsum(differences, axis=axis, dtype=np.uint16)
    return differences


def _load(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file; none where there is no file."""
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


@lru_cache(maxsize=1)
def known_optima() -> Archive:
    """The committed optima, read once.

    Raises:
        ValueError: if the data lacks a plant of the grid.
    """
    archive = Archive()
    missing = [plant for plant in PLANTS if key_of(Problem(M=plant[0], mu=plant[1])) not in archive.records]
    if missing:
        raise ValueError(f"{FOLDER / RECORDS} must hold every plant of the grid, lacks {missing}")
    return archive


def optimal_speed(M: float, mu: float) -> float:
    """The optimum's mean speed from rest over 33 s, torque held for 20 ms within 1.5 N m, in cm/s.

    Linear in M and in log(mu) between the plants of the grid, which can be off by some percent between them. At the
    plants it is the speed of a motion that was found, so that a share of it may exceed 1 a little.

    Args:
        M: mass of the platform, kg.
        mu: friction coefficient.

    Raises:
        ValueError: if the plant lies outside the grid.
    """
    return between_plants(_speeds(), M, mu)


def optimal_front() -> list[tuple[float, float]]:
    """Cost of transport and mean speed (cm/s) of the nominal plant's optima, none both slower and dearer than another.

    One for every energy weight on file, slowest first.
    """
    nominal = Problem()
    found = [
        (each.cost_of_transport, each.mean_speed)
        for each in known_optima().records.values()
        if (each.M, each.mu, each.hold, each.margin) == (nominal.M, nominal.mu, nominal.hold, nominal.margin)
        and each.cost_of_transport is not None
    ]
    undominated = [(cost, speed) for cost, speed in found if not any(c <= cost and s > speed for c, s in found)]
    return sorted(undominated, key=lambda point: point[1])


@lru_cache(maxsize=1)
def _speeds() -> dict[tuple[float, float], float]:
    """The speed of every plant of the grid, cm/s."""
    records = known_optima().records
    return {(M, mu): records[key_of(Problem(M=M, mu=mu))].mean_speed for M in GRID_M for mu in GRID_MU}
