"""The seven-phase profile (9) with optimal parameters: the problems, their assessment, the search and its file.

The free parameters are the seven times, V1 and P2 (P3 closes the cycle) and, in some problems, the initial angle. The
objective is the mean speed under exact tracking, subject to a torque limit and Principles 1 to 4. The bounds of the
principles are not published: the published profile's own largest angle, velocity and acceleration are used, so the
published profile is a candidate. Speeds that a search finds are lower bounds of the optimum.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from baselines.laws import profiles
from baselines.laws.profiles import PROPOSED, Profile, seven_phases
from baselines.laws.reference import platform_motion
from baselines.paper import published
from baselines.paper.optimal_profiles import DATA, GENERATIONS, PROG, SEED
from baselines.paper.principles import Cycle, principle_3, principle_4, sample
from capsule_gym.compilation import compile_cached
from capsule_gym.files import to_json, write_atomically
from capsule_gym.parameters import NOMINAL, NormalForce, Plant
from capsule_gym.task import START_THETA

TORQUE_LIMITS = (0.54, 1.0, 1.5)
# Readings of Principle 4: the first phase, counted from 1, in which (8) bounds the force, the first in which the
# platform must be at rest, and the form of (8). Each applies to the end of the cycle.
STANDSTILLS: dict[str, tuple[int, int, NormalForce]] = {
    # What the published profile satisfies: it enters phase V at 1.1 cm/s backwards and comes to rest within it.
    "return": (5, 6, "newton"),
    "strict-return": (5, 5, "newton"),
    # Definition 4: the restoring stage begins with phase IV.
    "restoring": (4, 4, "newton"),
    "printed": (4, 6, "paper"),
}
# Speed in m/s that counts as a violation of 1 where the platform must be at rest.
SPEED_SCALE = 0.1
ROUNDING = 1e-9

# The search integrates the platform's motion in steps of 1 ms, the final assessment in finer ones: hence the reserves.
TORQUE_RESERVE = 0.01
REST_RESERVE, BRAKING_REST_RESERVE = 0.005, 0.001  # s; the latter where the platform must rest from phase IV on
MEMBERS_PER_PARAMETER = 10
# These readings leave a narrow feasible set, which a single search often misses.
RESTARTS = {"restoring": 4, "printed": 4}
GRID = 1e-3  # s, of the times
# Shortest and longest duration of each phase, s; V1 in rad/s; P2 / V1; initial angle in rad.
DURATIONS = ((0.01, 1.0), (0.001, 1.0), (0.005, 1.0), (0.005, 2.0), (0.01, 3.0), (0.001, 6.0), (0.01, 3.0))
V1_RANGE, P2_SHARE, START_RANGE = (0.5, 25.0), (0.003, 0.99), (-1.5, 0.5)
# Of the repeated searches, which show how much a single search may miss.
OTHER_SEEDS = (4, 5, 6, 7, 8, 9, 10, 11)


@dataclass(frozen=True)
class Problem:
    """One optimisation.

    Attributes:
        torque_limit: N m.
        plants: "nominal", or "ranges" for the worst plant of the paper's ranges.
        dropped: number of the principle that is left out, 0 for none.
        standstill: reading of Principle 4, a key of `STANDSTILLS`.
        free_start: whether the initial angle is free; otherwise it is the paper's -pi/3.
    """

    torque_limit: float
    plants: str = "nominal"
    dropped: int = 0
    standstill: str = "return"
    free_start: bool = False

    @property
    def label(self) -> str:
        """The problem in words."""
        parts = [f"{self.torque_limit:g} N m", self.plants]
        parts += [f"without Principle {self.dropped}"] if self.dropped else []
        parts += [f"Principle 4: {self.standstill}"] if self.standstill != "return" else []
        parts += ["start free"] if self.free_start else []
        return ", ".join(parts)

    def plant_list(self) -> list[Plant]:
        """The plants on which a profile is assessed."""
        if self.plants == "nominal":
            return [NOMINAL.plant()]
        # Speed and demands are monotonic over the ranges, so the corners suffice; a test checks plants between them.
        return [NOMINAL.plant(M, mu) for M in published.M_RANGE for mu in published.MU_RANGE]


def problems() -> list[Problem]:
    """All problems, each after those from whose solutions it can start."""
    variants: list[dict[str, Any]] = [{}, *({"dropped": n} for n in (1, 2, 3, 4)), {"free_start": True}]
    variants += [{"standstill": "strict-return"}, {"plants": "ranges"}]
    # At -pi/3 the spring's torque alone, which the printed (8) counts as a force, exceeds the static friction 3 times.
    variants += [{"standstill": "printed", "free_start": True}, {"standstill": "restoring"}]
    return [Problem(limit, **variant) for variant in variants for limit in TORQUE_LIMITS]


@dataclass(frozen=True)
class Assessment:
    """A profile under exact tracking on the plants of a problem; the worst value over the plants of each number.

    Attributes:
        mean_speed: m/s, from rest, over the cycle, or over five cycles where the platform still moves after the first.
        cost_of_transport: integral of |u theta'| over (M + m) g and distance; infinite without progress.
        peak_torque: N m.
        backward_ratio: distance backwards over forwards; infinite where the platform only moves backwards.
        shares: load over limit of each demand; above 1 it is violated.
    """

    mean_speed: float
    cost_of_transport: float
    peak_torque: float
    backward_ratio: float
    shares: dict[str, float]

    @property
    def excess(self) -> float:
        """The sum of all violations; 0.0 where every demand is met."""
        return sum(share - 1.0 for share in self.shares.values() if share > 1.0 + ROUNDING)


@lru_cache(maxsize=1)
def published_bounds() -> tuple[float, float, float]:
    """theta_0 (rad), v_theta (rad/s) and a_theta (rad/s^2): the largest values of the published profile itself."""
    cycle = sample(PROPOSED)
    theta_0, v_theta, a_theta = (float(np.abs(x).max()) for x in (cycle.theta, cycle.theta_dot, cycle.theta_ddot))
    return theta_0, v_theta, a_theta


@lru_cache(maxsize=1)
def _platform_motion() -> Any:
    """`platform_motion`, compiled."""
    return compile_cached(platform_motion)


def assess(profile: Profile, problem: Problem, h: float = 1e-4, *, reserve: bool = False) -> Assessment:
    """Evaluates a profile under exact tracking.

    The platform's motion follows from the second row of Eq. (1), and the torque from the first.

    Args:
        profile: the profile.
        problem: its demands and plants.
        h: step of the platform's motion, s; divides every phase.
        reserve: apply the reserves of the search.

    Raises:
        ValueError: if the phases are no multiples of h.
    """
    durations = np.array([segment.duration for segment in profile.segments])
    counts = np.rint(durations / h).astype(np.int64)
    if np.abs(counts * h - durations).max() > 1e-9:
        raise ValueError(f"h must divide the phases of the profile, got {h!r} s for {durations.tolist()} s")
    # In the middle of the steps, where the acceleration does not jump; the demands hold at the ends of the phases too.
    t = (np.arange(counts.sum()) + 0.5) * h
    steps = Cycle(t, np.repeat(np.arange(len(counts)), counts), *profile.evaluate(t))
    ends = sample(profile, 2)
    cycle = Cycle(*(np.concatenate(pair) for pair in zip(vars(steps).values(), vars(ends).values(), strict=True)))
    rows = [_assess_plant(profile, problem, steps, cycle, h, reserve, p) for p in problem.plant_list()]
    shares = {name: max(row.shares[name] for row in rows) for name in rows[0].shares}
    return Assessment(
        min(row.mean_speed for row in rows),
        max(row.cost_of_transport for row in rows),
        max(row.peak_torque for row in rows),
        max(row.backward_ratio for row in rows),
        shares,
    )


def _assess_plant(
    profile: Profile, problem: Problem, steps: Cycle, cycle: Cycle, h: float, reserve: bool, p: Plant
) -> Assessment:
    """The assessment on one plant; `steps` are integrated, and the demands are evaluated at the samples of `cycle`."""
    t, theta, theta_dot, theta_ddot = steps.t, steps.theta, steps.theta_dot, steps.theta_ddot
    x, x_dot, x_ddot = _platform_motion()(theta, theta_dot, theta_ddot, h, p)
    if x_dot[-1] + h * x_ddot[-1] != 0.0:
        t, theta, theta_dot, theta_ddot = (np.tile(row, 5) for row in (t, theta, theta_dot, theta_ddot))
        x, x_dot, x_ddot = _platform_motion()(theta, theta_dot, theta_ddot, h, p)
    ml = p.m * p.l
    inertia = ml * (p.l * theta_ddot - np.cos(theta) * x_ddot)
    u = inertia - ml * p.g * np.sin(theta) + p.k * theta + p.c * theta_dot  # Eq. (1), first row
    distance, backward, energy = (
        float(x[-1]),
        float(np.maximum(0.0, -np.diff(x)).sum()),
        h * np.abs(u * theta_dot).sum(),
    )
    forward = distance + backward
    back = backward / forward if forward > 0.0 else math.inf if backward > 0.0 else 0.0
    cost = float(energy) / ((p.M + p.m) * p.g * distance) if distance > 0.0 else math.inf

    peak = float(np.abs(u).max())
    theta_0, v_theta, a_theta = published_bounds()
    shares = {"torque": peak / (problem.torque_limit * (1.0 - TORQUE_RESERVE * reserve))}
    # Without Principle 1 the platform still bounds the angle.
    shares["principle_1"] = float(np.abs(cycle.theta).max()) / (0.5 * math.pi if problem.dropped == 1 else theta_0)
    if problem.dropped != 2:
        shares["principle_2_velocity"] = float(np.abs(cycle.theta_dot).max()) / v_theta
        shares["principle_2_acceleration"] = float(np.abs(cycle.theta_ddot).max()) / a_theta
    if problem.dropped != 3:
        lift = principle_3(cycle, p)
        shares["principle_3"] = max(0.0, float(lift.ratio.max()))
    if problem.dropped != 4:
        force_from, rest_from, form = STANDSTILLS[problem.standstill]
        shares["principle_4_force"] = float(principle_4(cycle, p, form).ratio[cycle.phase >= force_from - 1].max())
        early = (BRAKING_REST_RESERVE if problem.standstill == "restoring" else REST_RESERVE) * reserve
        restless = float(np.abs(x_dot[t >= float(profile.times[rest_from - 2]) - early]).max())
        # In the later cycles as well: t repeats with them.
        shares["principle_4_rest"] = 1.0 + restless / SPEED_SCALE if restless > 0.0 else 0.0
    return Assessment(distance / (h * len(x)), cost, peak, back, shares)


@dataclass(frozen=True)
class Solution:
    """The result of a search.

    Attributes:
        problem: the problem.
        times: t1 to t7, s.
        V1: rad/s.
        P2: rad/s.
        start: rad.
        feasible: whether it meets every demand; otherwise it is the nearest profile that the search found.
        mean_speed: of the worst plant, m/s.
        cost_of_transport: of the worst plant; None without progress.
        peak_torque: of the worst plant, N m.
        backward_ratio: of the worst plant; None where the platform only moves backwards.
        shares: load over limit by demand, on the worst plant.
        found_by: the problem and the seed of the search that found it.
        evaluations: number of profiles that the problem's own search evaluated.
        seconds: duration of that search.
    """

    problem: Problem
    times: tuple[float, ...]
    V1: float
    P2: float
    start: float
    feasible: bool
    mean_speed: float
    cost_of_transport: float | None
    peak_torque: float
    backward_ratio: float | None
    shares: dict[str, float]
    found_by: str = ""
    evaluations: int = 0
    seconds: float = 0.0

    @property
    def rank(self) -> tuple[float, float]:
        """Sorts solutions of one problem, the best first: by violations, then by speed."""
        return (
            0.0 if self.feasible else sum(max(0.0, share - 1.0) for share in self.shares.values())
        ), -self.mean_speed

    @property
    def profile(self) -> Profile:
        """The profile."""
        name = "optimal" if self.feasible else "infeasible"
        return replace(seven_phases(self.times, self.V1, self.P2, name), start=self.start)


def make_solution(problem: Problem, times: tuple[float, ...], V1: float, P2: float, start: float) -> Solution:
    """A profile with its final assessment, in steps finer than those of the search."""
    found = assess(replace(seven_phases(times, V1, P2), start=start), problem)
    cost, back = (v if math.isfinite(v) else None for v in (found.cost_of_transport, found.backward_ratio))
    numbers = (found.excess == 0.0, found.mean_speed, cost, found.peak_torque, back, found.shares)
    return Solution(problem, times, V1, P2, start, *numbers)


def _decode(z: np.ndarray, problem: Problem) -> tuple[tuple[float, ...], float, float, float]:
    """Times, V1, P2 and initial angle of a point of the search space."""
    durations = np.maximum(1.0, np.rint(10.0 ** np.asarray(z[:7]) / GRID))
    times = tuple(float(t) for t in np.round(np.cumsum(durations) * GRID, 3))
    V1 = float(z[7]) if problem.dropped == 2 else min(float(z[7]), published_bounds()[1])
    return times, V1, V1 * float(10.0 ** z[8]), float(z[9]) if problem.free_start else START_THETA


def _bounds() -> np.ndarray:
    """Bounds of the search space, shape (10, 2): durations and P2 / V1 by their logarithm."""
    return np.array([*np.log10(DURATIONS), V1_RANGE, np.log10(P2_SHARE), START_RANGE])


def search(
    problem: Problem,
    known: Sequence[Solution] = (),
    *,
    seed: int = SEED,
    generations: int = GENERATIONS,
    members: int = MEMBERS_PER_PARAMETER,
    restarts: int | None = None,
) -> Solution:
    """Solves one problem by differential evolution: feasible profiles rank by speed, all others by violation.

    Args:
        problem: the problem.
        known: solutions of other problems; the best of them and of the published profile joins the first generation.
        seed: of the search.
        generations: number of generations.
        members: of a generation, per parameter.
        restarts: number of searches with successive seeds, of which the best counts; None takes `RESTARTS`.

    Raises:
        ImportError: if scipy is missing.
    """
    try:
        from scipy.optimize import differential_evolution
    except ImportError as error:
        raise ImportError('the search needs scipy: pip install "capsule-gym[paper]"') from error
    evaluations = 0

    def objective(z: np.ndarray) -> float:
        nonlocal evaluations
        evaluations += 1
        times, V1, P2, start = _decode(z, problem)
        found = assess(replace(seven_phases(times, V1, P2), start=start), problem, GRID, reserve=True)
        # Speeds in m/s are far below 1, where infeasible profiles begin.
        return -found.mean_speed if found.excess == 0.0 else 1.0 + min(found.excess, 1e9)

    began = perf_counter()
    candidates = [(PROPOSED.times, profiles.V1, profiles.P2, START_THETA)]
    candidates += [(np.array(each.times), each.V1, each.P2, each.start) for each in known]
    bounds = _bounds()
    points = [
        np.clip([*np.log10(np.diff([0.0, *times])), V1, math.log10(P2 / V1), start], *bounds.T)
        for times, V1, P2, start in candidates
    ]
    found = []
    for restart in range(seed, seed + (restarts or RESTARTS.get(problem.standstill, 1))):
        settings = {"x0": min(points, key=objective), "maxiter": generations, "popsize": members, "seed": restart}
        result = differential_evolution(objective, bounds, **settings, tol=0.0, init="sobol", polish=False)
        # In finer steps a member of the last generation may be infeasible: then the next best is taken.
        order = np.argsort(result.population_energies)
        members_found = (make_solution(problem, *_decode(result.population[i], problem)) for i in order)
        best = next((each for each in members_found if each.feasible), None)
        best = best or make_solution(problem, *_decode(result.x, problem))
        found.append(replace(best, found_by=f"{problem.label}, seed {restart}"))
    best = min(found, key=lambda each: each.rank)
    return replace(best, evaluations=evaluations, seconds=perf_counter() - began)


def exchange(solutions: Sequence[Solution]) -> list[Solution]:
    """Gives each problem the best profile that any search found, so that no slack of a search looks like an effect.

    Args:
        solutions: one per problem; evaluations and seconds stay those of the problem's own search.
    """
    exchanged = []
    for own in solutions:
        best = own
        for other in solutions:
            if other is own or (other.start != START_THETA and not own.problem.free_start):
                continue
            candidate = make_solution(own.problem, other.times, other.V1, other.P2, other.start)
            if candidate.rank < best.rank:
                best = replace(candidate, found_by=other.found_by, evaluations=own.evaluations, seconds=own.seconds)
        exchanged.append(best)
    return exchanged


@dataclass(frozen=True)
class Found:
    """The content of a file of searches.

    Attributes:
        seed: of the searches.
        generations: of each search.
        solutions: one per problem.
        spreads: speeds in m/s of further searches by problem, each alone with one of `OTHER_SEEDS`, without restarts,
            from the published profile; None where none of its profiles is feasible.
    """

    seed: int
    generations: int
    solutions: list[Solution]
    spreads: dict[Problem, list[float | None]]

    def relative_speeds(self, problem: Problem) -> list[float]:
        """The feasible repeated searches over the solution of their problem, minus 1, in ascending order."""
        stored = next(each.mean_speed for each in self.solutions if each.problem == problem)
        return sorted(speed / stored - 1.0 for speed in self.spreads[problem] if speed is not None)


def load(path: Path = DATA) -> Found:
    """Reads a file that `python -m baselines.paper.optimal_profiles` has written."""
    document = json.loads(path.read_text(encoding="utf-8"))
    for entry in (*document["solutions"], *document["spreads"]):
        entry["problem"] = Problem(**entry["problem"])
    solutions = [Solution(**{**entry, "times": tuple(entry["times"])}) for entry in document["solutions"]]
    spreads = {entry["problem"]: entry["speeds"] for entry in document["spreads"]}
    return Found(document["seed"], document["generations"], solutions, spreads)


def save(found: Found, path: Path) -> None:
    """Writes searches with their command and duration."""
    spreads = [{"problem": asdict(key), "seeds": OTHER_SEEDS, "speeds": value} for key, value in found.spreads.items()]
    document = {
        "command": f"{PROG} --seed {found.seed} --generations {found.generations}",
        "seed": found.seed,
        "generations": found.generations,
        "seconds": round(sum(each.seconds for each in found.solutions), 1),
        "bounds": dict(zip(("theta_0", "v_theta", "a_theta"), published_bounds(), strict=True)),
        "spreads": spreads,
        "solutions": [asdict(each) for each in found.solutions],
    }
    write_atomically(path, to_json(document))


def check(solutions: Sequence[Solution]) -> list[str]:
    """Assesses solutions again and lists the differences from what they record."""
    wrong = []
    for each in solutions:
        again = assess(each.profile, each.problem)
        if (again.excess == 0.0) != each.feasible or not math.isclose(again.mean_speed, each.mean_speed, rel_tol=1e-6):
            wrong.append(f"{each.problem.label}: {again}, recorded {each.mean_speed} m/s, feasible {each.feasible}")
    return wrong


def solve(found: Found, path: Path) -> None:
    """Solves the problems and repeats the searches that a file lacks; saves after each."""
    every = problems()
    missing = [problem for problem in every if problem not in {each.problem for each in found.solutions}]
    for problem in missing:
        found.solutions.append(search(problem, found.solutions, seed=found.seed, generations=found.generations))
        print(f"{problem.label}: {found.solutions[-1].mean_speed:.5f} m/s", flush=True)
        save(found, path)
    if missing:
        found.solutions[:] = exchange(sorted(found.solutions, key=lambda each: every.index(each.problem)))
        save(found, path)
    # The plain problems, and those with Principle 4 in phase IV as well.
    for problem in (Problem(limit, standstill=name) for name in ("return", "restoring") for limit in TORQUE_LIMITS):
        if problem not in found.spreads:
            again = (search(problem, seed=seed, generations=found.generations, restarts=1) for seed in OTHER_SEEDS)
            found.spreads[problem] = [each.mean_speed if each.feasible else None for each in again]
            print(f"{problem.label}, repeated: {found.spreads[problem]} m/s", flush=True)
            save(found, path)
