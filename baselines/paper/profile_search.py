"""The search for the profile (9) whose parameters are optimal: differential evolution, seeded, on one core."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from baselines.laws import profiles
from baselines.laws.profiles import PROPOSED, seven_phases
from baselines.paper.exact_tracking import assess
from baselines.paper.profile_problems import TORQUE_LIMITS, Problem, Solution
from baselines.paper.profile_settings import GENERATIONS, SEED
from capsule_gym.task import START_THETA

MEMBERS_PER_PARAMETER = 10
# Demands on phase IV leave a narrow set that a single search often misses.
RESTARTS = {"restoring": 4, "printed": 4}

# The search sees the platform's motion in steps of 1 ms only, and a law that tracks the profile samples at 1 ms.
TORQUE_RESERVE = 0.01
REST_RESERVE = 0.005  # s
# Before phase IV the pendulum still brakes hard: to be at rest much before its start is another demand.
BRAKING_REST_RESERVE = 0.001  # s
GRID = 1e-3  # s, of the times
# Shortest and longest duration of each phase, s.
DURATIONS = ((0.01, 1.0), (0.001, 1.0), (0.005, 1.0), (0.005, 2.0), (0.01, 3.0), (0.001, 6.0), (0.01, 3.0))
V1_RANGE = (0.5, 25.0)  # rad/s
P2_SHARE = (0.003, 0.99)  # of V1
START_RANGE = (-1.5, 0.5)  # rad

# Seeds of the further searches that show what one search may miss.
OTHER_SEEDS = (4, 5, 6, 7, 8, 9, 10, 11)


def _decode(z: np.ndarray, problem: Problem) -> tuple[tuple[float, ...], float, float, float]:
    """Times, V1, P2 and start of a point of the search space."""
    durations = np.maximum(1.0, np.rint(10.0 ** np.asarray(z[:7]) / GRID))
    times = tuple(float(t) for t in np.round(np.cumsum(durations) * GRID, 3))
    v_theta = problem.demands().v_theta
    V1 = float(z[7]) if v_theta is None else min(float(z[7]), v_theta)
    return times, V1, V1 * float(10.0 ** z[8]), float(z[9]) if problem.free_start else START_THETA


def _encode(times: Sequence[float] | np.ndarray, V1: float, P2: float, start: float) -> np.ndarray:
    """The point of the search space that stands for a profile."""
    point = np.array([*np.log10(np.diff([0.0, *times])), V1, math.log10(P2 / V1), start])
    low, high = np.array(_bounds()).T
    return np.clip(point, low, high)


def _bounds() -> list[tuple[float, float]]:
    """Bounds of the search space: durations and P2 / V1 by their logarithm."""
    logarithmic = [(math.log10(low), math.log10(high)) for low, high in (*DURATIONS, P2_SHARE)]
    return [*logarithmic[:7], V1_RANGE, logarithmic[7], START_RANGE]


def search(
    problem: Problem,
    known: Sequence[Solution] = (),
    *,
    seed: int = SEED,
    generations: int = GENERATIONS,
    members: int = MEMBERS_PER_PARAMETER,
    restarts: int | None = None,
) -> Solution:
    """Solves one problem by differential evolution: feasible profiles by speed, before all others by violation.

    Args:
        problem: what to solve.
        known: solutions of other problems; the best for this one joins the first generation. Without any, the
            published profile does.
        seed: of the search.
        generations: that the search goes through.
        members: of a generation, per parameter.
        restarts: searches with successive seeds, of which the best counts; None takes `RESTARTS`.

    Raises:
        ImportError: if scipy is missing.
    """
    try:
        from scipy.optimize import differential_evolution
    except ImportError as error:
        raise ImportError('the search needs scipy: pip install "capsule-gym[paper]"') from error

    demands, plants = problem.demands(), problem.plant_list()
    tightened = replace(demands, torque=(1.0 - TORQUE_RESERVE) * demands.torque)
    early = BRAKING_REST_RESERVE if problem.standstill == "restoring" else REST_RESERVE
    evaluations = 0

    def aim(z: np.ndarray) -> float:
        nonlocal evaluations
        evaluations += 1
        times, V1, P2, start = _decode(z, problem)
        profile = replace(seven_phases(times, V1, P2), start=start)
        assessment = assess(profile, tightened, plants, h=GRID, early=early)
        # Speeds in m/s stay far below 1, where the infeasible ones begin.
        return -assessment.mean_speed if assessment.feasible else 1.0 + min(assessment.excess, 1e9)

    began = perf_counter()
    starts = [
        _encode(PROPOSED.times, profiles.V1, profiles.P2, START_THETA),
        *(_encode(each.times, each.V1, each.P2, each.start) for each in known),
    ]
    x0 = min(starts, key=aim)
    found = []
    for restart in range(seed, seed + (restarts or RESTARTS.get(problem.standstill, 1))):
        result = differential_evolution(
            aim,
            _bounds(),
            x0=x0,
            maxiter=generations,
            popsize=members,
            tol=0.0,
            init="sobol",
            polish=False,
            seed=restart,
        )
        found.append(replace(_best_member(problem, result), found_by=f"{problem.label}, seed {restart}"))
    best = min(found, key=lambda each: each.rank)
    return replace(best, evaluations=evaluations, seconds=perf_counter() - began)


def _best_member(problem: Problem, result: Any) -> Solution:
    """The best of a search's last generation.

    Judged in finer steps, a member may fail by what the search's steps did not see: then the next best.
    """
    order = np.argsort(result.population_energies)
    candidates = (_solution(problem, *_decode(result.population[i], problem)) for i in order)
    feasible = next((each for each in candidates if each.feasible), None)
    return feasible or _solution(problem, *_decode(result.x, problem))


def exchange(solutions: Sequence[Solution]) -> list[Solution]:
    """Gives each problem the best profile that any of the searches has found for it.

    Without it the slack of the searches could pass for the effect of a demand. Evaluations and seconds stay those of
    the problem's own search.

    Args:
        solutions: one per problem.
    """
    exchanged = []
    for own in solutions:
        best = own
        for other in solutions:
            if other is own or (other.start != START_THETA and not own.problem.free_start):
                continue
            candidate = _solution(own.problem, other.times, other.V1, other.P2, other.start)
            if candidate.rank < best.rank:
                best = replace(candidate, found_by=other.found_by, evaluations=own.evaluations, seconds=own.seconds)
        exchanged.append(best)
    return exchanged


def _solution(problem: Problem, times: tuple[float, ...], V1: float, P2: float, start: float) -> Solution:
    """A point of the search with its final assessment, in steps finer than the search's."""
    profile = replace(seven_phases(times, V1, P2), start=start)
    found = assess(profile, problem.demands(), problem.plant_list())
    cost = found.cost_of_transport if math.isfinite(found.cost_of_transport) else None
    backward = found.backward_ratio if math.isfinite(found.backward_ratio) else None
    values = (found.mean_speed, cost, found.peak_torque, backward, found.shares)
    return Solution(problem, times, V1, P2, start, found.feasible, *values)


@dataclass(frozen=True)
class Spread:
    """What further searches find for one problem, each alone, without restarts, and from the published profile.

    Attributes:
        problem: what was asked.
        seeds: of the searches.
        speeds: that they found, m/s; None where none of their profiles met every demand.
    """

    problem: Problem
    seeds: tuple[int, ...]
    speeds: tuple[float | None, ...]

    @property
    def feasible(self) -> tuple[float, ...]:
        """The speeds of the searches that found a profile, m/s."""
        return tuple(speed for speed in self.speeds if speed is not None)


def spread_problems() -> list[Problem]:
    """The problems whose search is repeated: the plain ones, and those with Principle 4 on phase IV as well."""
    return [Problem(limit, standstill=reading) for reading in ("return", "restoring") for limit in TORQUE_LIMITS]


def search_again(problem: Problem, seeds: Sequence[int] = OTHER_SEEDS, *, generations: int = GENERATIONS) -> Spread:
    """Repeats the search for one problem.

    Args:
        problem: what to solve.
        seeds: one search each.
        generations: that each goes through.
    """
    found = [search(problem, seed=seed, generations=generations, restarts=1) for seed in seeds]
    return Spread(problem, tuple(seeds), tuple(each.mean_speed if each.feasible else None for each in found))
