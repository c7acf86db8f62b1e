"""Optimises the paper's seven-phase profile (9): `python -m baselines.paper.optimal_profiles`.

The free parameters are the seven times, V1 and P2; P3 closes the cycle. The objective is the mean
speed under exact tracking, subject to a torque limit and Principles 1 to 4. The bounds of the
principles are not published: the published profile's own largest angle, velocity and acceleration
are used, so that this profile is a candidate. Speeds that a search finds are lower bounds of the
optimum.
"""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from baselines.paper import published
from baselines.paper.principles import Cycle, principle_3, principle_4, sample
from baselines.paper.tracking import CYCLES
from capsule_gym.command_line import check_output, command
from capsule_gym.control.laws.profiles import (
    OPTIMA,
    P2,
    PROPOSED,
    V1,
    Profile,
    platform_motion,
    seven_phases,
)
from capsule_gym.files import to_json, write_atomically
from capsule_gym.parameters import NOMINAL, Plant

PROG = "python -m baselines.paper.optimal_profiles"
TORQUE_LIMITS = (0.54, 1.0, 1.5)
# Principle 4 as a demand on the return of the pendulum, which the published profile meets: (8)
# bounds the force from phase V on, which the platform enters at 1.1 cm/s backwards, and the
# platform rests from phase VI on.
FORCE_FROM = 5
REST_FROM = 6
# Speed in m/s that counts as a violation of 1 where the platform must be at rest.
SPEED_SCALE = 0.1
ROUNDING = 1e-9
# theta_0 (rad), v_theta (rad/s) and a_theta (rad/s^2): the largest values of the published profile
# itself.
BOUNDS = np.abs(sample(PROPOSED).motion).max(axis=1)

# The search integrates the platform's motion in steps of 1 ms, the final assessment in finer ones:
# hence the reserves.
TORQUE_RESERVE = 0.01
REST_RESERVE = 0.005  # s
GRID = 1e-3  # s, of the times
# Shortest and longest duration of each phase, s; V1 in rad/s; P2 / V1.
DURATIONS = (
    (0.01, 1.0),
    (0.001, 1.0),
    (0.005, 1.0),
    (0.005, 2.0),
    (0.01, 3.0),
    (0.001, 6.0),
    (0.01, 3.0),
)
V1_RANGE = (0.5, 25.0)
P2_SHARE = (0.003, 0.99)
MAX_EXCESS = 1e9  # of a profile in the search


@dataclass(frozen=True)
class ProfileProblem:
    """One optimisation: the torque limit in N m, the plants, and a principle left out or 0.

    The plants are "nominal" or "ranges", of which the worst counts.
    """

    torque_limit: float
    plants: str = "nominal"
    dropped: int = 0

    @property
    def label(self) -> str:
        """The problem in words."""
        label = f"{self.torque_limit:g} N m, {self.plants}"
        return f"{label}, without Principle {self.dropped}" if self.dropped else label

    def plant_list(self) -> list[Plant]:
        """The plants on which a profile is assessed."""
        if self.plants == "nominal":
            return [NOMINAL.plant()]
        # Speed and demands are monotonic over the ranges, so the corners suffice; a test checks
        # plants between them.
        return [NOMINAL.plant(M, mu) for M in published.M_RANGE for mu in published.MU_RANGE]


def problems() -> list[ProfileProblem]:
    """All problems, each after those from whose solutions it can start."""
    nominal = [ProfileProblem(limit) for limit in TORQUE_LIMITS]
    relaxed = [replace(problem, dropped=n) for n in (2, 3, 4) for problem in nominal]
    robust = [replace(problem, plants="ranges") for problem in nominal]
    return nominal + relaxed + robust


@dataclass(frozen=True)
class Solution:
    """A profile (9) under exact tracking, in SI units; values are the worst over the plants."""

    problem: ProfileProblem
    times: tuple[float, ...]  # t1 to t7
    V1: float
    P2: float
    feasible: bool  # whether it meets every demand
    # From rest, over the cycle, or over five where the platform still moves after the first.
    mean_speed: float
    cost_of_transport: float | None  # None without progress
    peak_torque: float
    # Distance backwards over forwards; None where the platform only moves backwards.
    backward_ratio: float | None
    shares: dict[str, float]  # load over limit of each demand; above 1 it is violated
    found_by: str = ""  # the problem and the seed of the search that found it

    @property
    def excess(self) -> float:
        """The sum of all violations; 0.0 where every demand is met."""
        violated = [share for share in self.shares.values() if share > 1.0 + ROUNDING]
        return sum(share - 1.0 for share in violated)


def assess(
    problem: ProfileProblem,
    times: Sequence[float],
    V1: float,
    P2: float,
    h: float = 1e-4,
    *,
    reserve: bool = False,
) -> Solution:
    """Evaluates a profile under exact tracking in steps of h seconds, which divide every phase.

    `reserve` applies the reserves of the search.
    """
    profile = seven_phases(times, V1, P2)
    durations = np.array([segment.duration for segment in profile.segments])
    counts = np.rint(durations / h).astype(np.int64)
    # In the middle of the steps, where the acceleration does not jump; the demands hold at the ends
    # of the phases too.
    t = (np.arange(counts.sum()) + 0.5) * h
    phase = np.repeat(np.arange(len(counts)), counts)
    steps = Cycle(t, phase, *profile.evaluate(t))
    ends = sample(profile, 2)
    pairs = zip(vars(steps).values(), vars(ends).values(), strict=True)
    cycle = Cycle(*map(np.concatenate, pairs))

    motions = []
    demands = []
    for plant in problem.plant_list():
        motion = _move(steps, h, plant)
        motions.append(motion)
        demands.append(_demands(problem, profile, motion, cycle, plant, reserve))
    shares = {name: max(each[name] for each in demands) for name in demands[0]}
    return Solution(
        problem=problem,
        times=tuple(times),
        V1=V1,
        P2=P2,
        feasible=all(share <= 1.0 + ROUNDING for share in shares.values()),
        mean_speed=min(motion.mean_speed for motion in motions),
        cost_of_transport=_largest([motion.cost_of_transport for motion in motions]),
        peak_torque=max(motion.peak_torque for motion in motions),
        backward_ratio=_largest([motion.backward_ratio for motion in motions]),
        shares=shares,
    )


def _largest(values: list[float]) -> float | None:
    largest = max(values)
    return largest if math.isfinite(largest) else None


class _Motion(NamedTuple):
    """A profile under exact tracking on one plant, in SI units."""

    t: np.ndarray  # repeats with the cycles
    x_dot: np.ndarray
    mean_speed: float
    peak_torque: float
    cost_of_transport: float  # infinite without progress
    backward_ratio: float  # infinite where the platform only moves backwards


def _move(steps: Cycle, h: float, p: Plant) -> _Motion:
    """Integrates the platform's motion over a cycle, or over five where it does not end at rest."""
    t = steps.t
    theta, theta_dot, theta_ddot = steps.motion
    x, x_dot, x_ddot = platform_motion(theta, theta_dot, theta_ddot, h, p)
    last_x_dot = x_dot[-1] + h * x_ddot[-1]
    if last_x_dot != 0.0:
        t, theta, theta_dot, theta_ddot = (np.tile(row, CYCLES) for row in (t, *steps.motion))
        x, x_dot, x_ddot = platform_motion(theta, theta_dot, theta_ddot, h, p)
    ml = p.m * p.l
    inertia = ml * (p.l * theta_ddot - np.cos(theta) * x_ddot)
    weight = ml * p.g * np.sin(theta)
    u = inertia - weight + p.k * theta + p.c * theta_dot  # Eq. (1), first row
    energy = h * float(np.abs(u * theta_dot).sum())
    distance = float(x[-1])
    moved = np.diff(x)
    forward = float(np.maximum(0.0, moved).sum())
    backward = float(np.maximum(0.0, -moved).sum())
    cost_of_transport = backward_ratio = math.inf
    if distance > 0.0:
        cost_of_transport = energy / ((p.M + p.m) * p.g * distance)
    if forward > 0.0:
        backward_ratio = backward / forward
    elif backward == 0.0:
        backward_ratio = 0.0
    return _Motion(
        t,
        x_dot,
        mean_speed=distance / (h * len(x)),
        peak_torque=float(np.abs(u).max()),
        cost_of_transport=cost_of_transport,
        backward_ratio=backward_ratio,
    )


def _demands(
    problem: ProfileProblem,
    profile: Profile,
    motion: _Motion,
    cycle: Cycle,
    p: Plant,
    reserve: bool,
) -> dict[str, float]:
    """Load over limit of each demand, at the samples of `cycle`."""
    largest = np.abs(cycle.motion).max(axis=1)
    angle, velocity, acceleration = (largest / BOUNDS).tolist()
    limit = problem.torque_limit * (1.0 - TORQUE_RESERVE * reserve)
    shares = {"torque": motion.peak_torque / limit, "principle_1": angle}
    if problem.dropped != 2:
        shares["principle_2_velocity"] = velocity
        shares["principle_2_acceleration"] = acceleration
    if problem.dropped != 3:
        shares["principle_3"] = max(0.0, float(principle_3(cycle, p).ratio.max()))
    if problem.dropped != 4:
        returning = cycle.phase >= FORCE_FROM - 1
        shares["principle_4_force"] = float(principle_4(cycle, p).ratio[returning].max())
        rest = float(profile.times[REST_FROM - 2]) - REST_RESERVE * reserve
        # In the later cycles as well: t repeats with them.
        restless = float(np.abs(motion.x_dot[motion.t >= rest]).max())
        shares["principle_4_rest"] = 1.0 + restless / SPEED_SCALE if restless > 0.0 else 0.0
    return shares


def _decode(z: np.ndarray, problem: ProfileProblem) -> tuple[tuple[float, ...], float, float]:
    """Times, V1 and P2 of a point of the search space."""
    intervals = np.maximum(1.0, np.rint(10.0 ** z[:7] / GRID))
    times = np.round(np.cumsum(intervals) * GRID, 3)
    velocity = float(z[7])
    _, largest_velocity, _ = BOUNDS.tolist()
    # Principle 2 bounds the motion.
    if problem.dropped != 2:
        velocity = min(velocity, largest_velocity)
    share = float(10.0 ** z[8])
    return tuple(times.tolist()), velocity, velocity * share


def _encode(times: Sequence[float], V1: float, P2: float) -> list[float]:
    """The point of the search space of a profile, which may lie outside its bounds."""
    durations = np.diff([0.0, *times])
    return [*np.log10(durations), V1, math.log10(P2 / V1)]


def search(
    problem: ProfileProblem,
    known: Sequence[Solution] = (),
    *,
    seed: int,
    generations: int,
    members: int = 10,
) -> Solution:
    """Solves one problem by differential evolution.

    Feasible profiles rank by speed, all others by violation. The best of the `known` solutions and
    of the published profile joins the first generation.
    """
    from scipy.optimize import differential_evolution

    def objective(z: np.ndarray) -> float:
        found = assess(problem, *_decode(z, problem), GRID, reserve=True)
        # Speeds in m/s are far below 1, where infeasible profiles begin.
        return -found.mean_speed if found.feasible else 1.0 + min(found.excess, MAX_EXCESS)

    # Durations and P2 / V1 by their logarithm.
    bounds = np.vstack([np.log10(DURATIONS), V1_RANGE, np.log10(P2_SHARE)])
    points = [_encode(PROPOSED.times.tolist(), V1, P2)]
    points += [_encode(solution.times, solution.V1, solution.P2) for solution in known]
    result = differential_evolution(
        objective,
        bounds,
        x0=min(np.clip(points, *bounds.T), key=objective),
        maxiter=generations,
        popsize=members,
        seed=seed,
        tol=0.0,
        init="sobol",
        polish=False,
    )
    # In finer steps a member of the last generation may be infeasible: then the next best is taken.
    order = np.argsort(result.population_energies)
    solutions = [assess(problem, *_decode(z, problem)) for z in result.population[order]]
    best = next((solution for solution in solutions if solution.feasible), solutions[0])
    return replace(best, found_by=f"{problem.label}, seed {seed}")


def exchange(solutions: Sequence[Solution]) -> list[Solution]:
    """Gives each problem the best profile of any search.

    An incomplete search then does not look like an effect.
    """
    exchanged = []
    for own in solutions:
        found = [own]
        for other in solutions:
            assessed = assess(own.problem, other.times, other.V1, other.P2)
            found.append(replace(assessed, found_by=other.found_by))
        best = min(found, key=lambda solution: (solution.excess, -solution.mean_speed))
        exchanged.append(best)
    return exchanged


def load(path: Path = OPTIMA) -> list[Solution]:
    """Reads the solutions that the command has written."""
    solutions = []
    for row in json.loads(path.read_text(encoding="utf-8"))["solutions"]:
        problem = ProfileProblem(**row.pop("problem"))
        times = tuple(row.pop("times"))
        solutions.append(Solution(problem, times, **row))
    return solutions


@command(PROG, ValueError)
def main(
    json: Path = OPTIMA, seed: int = 0, generations: int = 200, overwrite: bool = False
) -> None:
    """Optimises the paper's profile (9) for speed.

    Under exact tracking, Principles 1 to 4 and a torque limit. About half an hour on one core.

    Examples:
      python -m baselines.paper.optimal_profiles --json mine.json    solve all problems
      python -m baselines.paper.optimal_profiles --json short.json --generations 5    a short search

    Args:
        json: File of the results.
        seed: Seed of the searches.
        generations: Generations of each search.
        overwrite: Replace an existing file.
    """
    check_output("--json", json, overwrite=overwrite)
    solutions: list[Solution] = []
    for problem in problems():
        found = search(problem, solutions, seed=seed, generations=generations)
        solutions.append(found)
        print(f"{problem.label}: {found.mean_speed:.5f} m/s", flush=True)
    theta_0, v_theta, a_theta = BOUNDS.tolist()
    document = {
        "command": f"{PROG} --seed {seed} --generations {generations}",
        "bounds": {"theta_0": theta_0, "v_theta": v_theta, "a_theta": a_theta},
        "solutions": [asdict(each) for each in exchange(solutions)],
    }
    write_atomically(json, to_json(document))
    print(f"{len(solutions)} solutions written to {json}")


if __name__ == "__main__":
    sys.exit(main())
