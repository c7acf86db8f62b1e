"""The plants of a student's training episodes, each with the values of its own optimum.

Plants with the same pendulum, friction of the motor and static ratio form a group, within which M
and mu may change during an episode. A file per plant keeps its values:

    0000.npz             `constants` and the fields of the solution

A file whose constants are those of the plant is not solved again.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.distillation.config import RIG, Student
from baselines.dynamic_programming.archive import known_results, solve_near
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.problem import CONSTANTS, PENDULUM, Problem
from baselines.dynamic_programming.solver import Solution
from capsule_gym.envs.contract import draw_plant, ends
from capsule_gym.files import load_arrays, replacing
from capsule_gym.parameters import (
    DISTURBANCES,
    NOMINAL,
    RANDOMIZATIONS,
    REAL,
    Capsule,
    Disturbances,
    Randomization,
)
from capsule_gym.parameters.disturbances import SAMPLING

# Every group draws its own plants, the same in all runs.
SEED = 63
# Share by which the ranges of the solutions are longer than those of nominal plants.
ROOM = 0.15
STATIC_RATIO = 1.3


@dataclass(frozen=True)
class Group:
    """Plants that differ in M and mu only.

    Attributes:
        severity: size of the disturbances relative to `disturbances`; None draws it anew for
            each disturbance of each episode.
        problems: the plants' problems.
        targets: those to which an episode may change.
        disturbances: the disturbances in their full size.
    """

    severity: float | None
    problems: tuple[Problem, ...]
    targets: tuple[Problem, ...]
    disturbances: Disturbances


def draw_groups(student: Student) -> list[Group]:
    """The groups of a student's training plants."""
    ranges, disturbances, capsule = _full_size(student)
    groups = []
    for n in range(student.groups):
        rng = np.random.default_rng([SEED, n])
        severity = student.severities[n % len(student.severities)]
        size = rng.random() if severity is None else severity
        constants = {}
        for name in PENDULUM:
            usual = getattr(capsule, name)
            low, high = getattr(ranges, name) or (usual, usual)
            constants[name] = usual + size * (rng.uniform(low, high) - usual)
        sticky = rng.random() < student.sticky_share
        constants["static_ratio"] = STATIC_RATIO if sticky else capsule.static_ratio
        _, friction = ends(disturbances.motor_friction)
        constants["motor_friction"] = capsule.motor_friction + size * friction
        for name in ("static_ratio", "motor_friction"):
            if getattr(ranges, name) is not None:
                constants[name] = rng.uniform(*getattr(ranges, name))
        shared = Problem(**constants)
        problems = []
        for randomization, count in student.plants.items():
            for _ in range(count):
                own = ranges if randomization == RIG else RANDOMIZATIONS[randomization]
                M, mu = draw_plant(own, capsule, rng)
                problems.append(replace(shared, M=M, mu=mu))
        targets = problems[: student.plants.get("wide", 0)]
        groups.append(Group(severity, tuple(problems), tuple(targets), disturbances))
    return groups


def _full_size(student: Student) -> tuple[Randomization, Disturbances, Capsule]:
    """The distribution of the pendulums, the disturbances, and the constants without deviations.

    They are those of `real`, or of an identified rig.
    """
    if isinstance(student.randomization, str):
        return RANDOMIZATIONS["real"], REAL, NOMINAL
    disturbances = Disturbances.named(student.disturbances)
    return student.randomization, disturbances or Disturbances(), student.observation["capsule"]


def draw_disturbances(group: Group, rng: np.random.Generator) -> dict[str, float]:
    """The disturbances of an episode; the motor's friction is that of the group's plants."""
    drawn: dict[str, float] = {}
    for name in DISTURBANCES:
        low, high = ends(getattr(group.disturbances, name))
        if name in SAMPLING and low == high == 0.0:
            # No draw, so that those of older students stay the same.
            drawn[name] = 0.0
            continue
        size = rng.random() if group.severity is None else group.severity
        drawn[name] = size * rng.uniform(low, high)
    drawn["drift_time"] = rng.uniform(*ends(group.disturbances.drift_time))
    drawn["motor_friction"] = group.problems[0].motor_friction
    return drawn


def draw_changes(
    group: Group, rate: float, seconds: float, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """The changes of M and mu in an episode, `rate` per second on average."""
    count = rng.poisson(rate * seconds)
    changes: list[dict[str, Any]] = []
    for t in sorted(rng.uniform(0.0, seconds, count).tolist()):
        problem = group.targets[rng.integers(len(group.targets))]
        changes.append({"t": t, "M": problem.M, "mu": problem.mu})
    return changes


def solve_groups(groups: Sequence[Group], folder: Path, jobs: int = -1) -> list[Solution]:
    """The solutions of all plants of groups, as `solve_problems`."""
    problems = [problem for group in groups for problem in group.problems]
    return solve_problems(problems, folder, jobs)


def solve_problems(problems: Sequence[Problem], folder: Path, jobs: int = -1) -> list[Solution]:
    """The solutions of problems, from files of a folder where they have been solved before."""
    # Imported here, since --help does not need it.
    from joblib import Parallel, delayed

    paths = [folder / f"{n:04}.npz" for n in range(len(problems))]
    found = [_read(path, problem) for path, problem in zip(paths, problems, strict=True)]
    missing = [n for n, solution in enumerate(found) if solution is None]
    if missing:
        work = Parallel(jobs, return_as="generator_unordered")
        solving = work(delayed(_solve)(problems[n], paths[n]) for n in missing)
        text = "solving plants"
        for _ in tqdm(solving, text, len(missing), unit="plant", file=sys.stderr, disable=None):
            pass
        return solve_problems(problems, folder, jobs)
    return [solution for solution in found if solution is not None]


def _constants(problem: Problem) -> np.ndarray:
    """M, mu and the others, as in the plant's file."""
    return np.array([getattr(problem, name) for name in ("M", "mu", *CONSTANTS)])


def _solve(problem: Problem, path: Path) -> None:
    """Solves a plant and writes its file."""
    solution = solve_near(problem, known_results(), room=ROOM)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        np.savez_compressed(
            temporary,
            constants=_constants(problem),
            values=solution.values,
            y=solution.grid.y,
            w=solution.grid.w,
            curvature=solution.curvature,
            gain=solution.gain,
        )


def _read(path: Path, problem: Problem) -> Solution | None:
    """The solution of a plant in a file, or None if the file has none of this plant."""
    if not path.is_file():
        return None
    arrays = load_arrays(path)
    if not np.array_equal(arrays["constants"], _constants(problem)):
        return None
    values = arrays["values"]
    y = tuple(arrays["y"].tolist())
    w = tuple(arrays["w"].tolist())
    grid = Grid(values.shape, y, w, problem.q)
    return Solution(problem, grid, values, float(arrays["curvature"]), float(arrays["gain"]))
