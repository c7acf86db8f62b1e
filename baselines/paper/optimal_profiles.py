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
from typing import Any

import numpy as np

from baselines.paper import published
from baselines.paper.principles import Cycle, principle_3, principle_4, sample
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
FORCE_FROM, REST_FROM = 5, 6
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
V1_RANGE, P2_SHARE = (0.5, 25.0), (0.003, 0.99)


@dataclass(frozen=True)
class ProfileProblem:
    """One optimisation: a torque limit (N m), "nominal" or the worst of the "ranges", and a
    principle left out or 0.
    """

    torque_limit: float
    plants: str = "nominal"
    dropped: int = 0

    @property
    def label(self) -> str:
        """The problem in words."""
        return (
            f"{self.torque_limit:g} N m, {self.plants}"
            + f", without Principle {self.dropped}" * bool(self.dropped)
        )

    def plant_list(self) -> list[Plant]:
        """The plants on which a profile is assessed."""
        if self.plants == "nominal":
            return [NOMINAL.plant()]
        # Speed and demands are monotonic over the ranges, so the corners suffice; a test checks
        # plants between them.
        return [NOMINAL.plant(M, mu) for M in published.M_RANGE for mu in published.MU_RANGE]


def problems() -> list[ProfileProblem]:
    """All problems, each after those from whose solutions it can start."""
    variants: list[dict[str, Any]] = [
        {},
        *({"dropped": n} for n in (2, 3, 4)),
        {"plants": "ranges"},
    ]
    return [ProfileProblem(limit, **variant) for variant in variants for limit in TORQUE_LIMITS]


@dataclass(frozen=True)
class Solution:
    """A profile (9) under exact tracking on the plants of a problem, in SI units; the worst value
    over the plants.
    """

    problem: ProfileProblem
    times: tuple[float, ...]  # t1 to t7
    V1: float
    P2: float
    feasible: bool  # whether it meets every demand
    mean_speed: float  # from rest, over the cycle, or over five where the platform still moves after the first
    cost_of_transport: float | None  # None without progress
    peak_torque: float
    backward_ratio: (
        float | None
    )  # distance backwards over forwards; None where the platform only moves backwards
    shares: dict[str, float]  # load over limit of each demand; above 1 it is violated
    found_by: str = ""  # the problem and the seed of the search that found it

    @property
    def excess(self) -> float:
        """The sum of all violations; 0.0 where every demand is met."""
        return sum(share - 1.0 for share in self.shares.values() if share > 1.0 + ROUNDING)


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
    counts = np.rint(np.array([segment.duration for segment in profile.segments]) / h).astype(
        np.int64
    )
    # In the middle of the steps, where the acceleration does not jump; the demands hold at the ends
    # of the phases too.
    t = (np.arange(counts.sum()) + 0.5) * h
    steps = Cycle(t, np.repeat(np.arange(len(counts)), counts), *profile.evaluate(t))
    ends = sample(profile, 2)
    cycle = Cycle(
        *(
            np.concatenate(pair)
            for pair in zip(vars(steps).values(), vars(ends).values(), strict=True)
        )
    )
    rows = [
        _assess_plant(problem, profile, steps, cycle, h, reserve, p) for p in problem.plant_list()
    ]
    speeds, costs, peaks, backward, loads = zip(*rows, strict=True)
    shares = {name: max(row[name] for row in loads) for name in loads[0]}
    cost, back = (
        max(values) if math.isfinite(max(values)) else None for values in (costs, backward)
    )
    feasible = all(share <= 1.0 + ROUNDING for share in shares.values())
    return Solution(
        problem, tuple(times), V1, P2, feasible, min(speeds), cost, max(peaks), back, shares
    )


def _assess_plant(
    problem: ProfileProblem,
    profile: Profile,
    steps: Cycle,
    cycle: Cycle,
    h: float,
    reserve: bool,
    p: Plant,
) -> tuple[float, float, float, float, dict[str, float]]:
    """The assessment on one plant; `steps` are integrated, and the demands are evaluated at the
    samples of `cycle`.
    """
    t, (theta, theta_dot, theta_ddot) = steps.t, steps.motion
    x, x_dot, x_ddot = platform_motion(theta, theta_dot, theta_ddot, h, p)
    if x_dot[-1] + h * x_ddot[-1] != 0.0:
        t, theta, theta_dot, theta_ddot = (
            np.tile(row, 5) for row in (t, theta, theta_dot, theta_ddot)
        )
        x, x_dot, x_ddot = platform_motion(theta, theta_dot, theta_ddot, h, p)
    ml = p.m * p.l
    inertia = ml * (p.l * theta_ddot - np.cos(theta) * x_ddot)
    u = inertia - ml * p.g * np.sin(theta) + p.k * theta + p.c * theta_dot  # Eq. (1), first row
    distance, backward = float(x[-1]), float(np.maximum(0.0, -np.diff(x)).sum())
    energy, peak, forward = (
        h * float(np.abs(u * theta_dot).sum()),
        float(np.abs(u).max()),
        distance + backward,
    )
    back = backward / forward if forward > 0.0 else math.inf if backward > 0.0 else 0.0
    cost = energy / ((p.M + p.m) * p.g * distance) if distance > 0.0 else math.inf

    angle, velocity, acceleration = (np.abs(cycle.motion).max(axis=1) / BOUNDS).tolist()
    shares = {
        "torque": peak / (problem.torque_limit * (1.0 - TORQUE_RESERVE * reserve)),
        "principle_1": angle,
    }
    if problem.dropped != 2:
        shares |= {"principle_2_velocity": velocity, "principle_2_acceleration": acceleration}
    if problem.dropped != 3:
        shares["principle_3"] = max(0.0, float(principle_3(cycle, p).ratio.max()))
    if problem.dropped != 4:
        shares["principle_4_force"] = float(
            principle_4(cycle, p).ratio[cycle.phase >= FORCE_FROM - 1].max()
        )
        restless = float(
            np.abs(x_dot[t >= float(profile.times[REST_FROM - 2]) - REST_RESERVE * reserve]).max()
        )
        # In the later cycles as well: t repeats with them.
        shares["principle_4_rest"] = 1.0 + restless / SPEED_SCALE if restless > 0.0 else 0.0
    return distance / (h * len(x)), cost, peak, back, shares


def _decode(z: np.ndarray, problem: ProfileProblem) -> tuple[tuple[float, ...], float, float]:
    """Times, V1 and P2 of a point of the search space."""
    durations = np.maximum(1.0, np.rint(10.0 ** np.asarray(z[:7]) / GRID))
    times = tuple(float(t) for t in np.round(np.cumsum(durations) * GRID, 3))
    V1 = float(z[7] if problem.dropped == 2 else min(z[7], BOUNDS[1]))
    return times, V1, V1 * float(10.0 ** z[8])


def search(
    problem: ProfileProblem,
    known: Sequence[Solution] = (),
    *,
    seed: int,
    generations: int,
    members: int = 10,
) -> Solution:
    """Solves one problem by differential evolution: feasible profiles rank by speed, all others by
    violation.

    The best of the `known` solutions and of the published profile joins the first generation.
    """
    from scipy.optimize import differential_evolution

    def objective(z: np.ndarray) -> float:
        found = assess(problem, *_decode(z, problem), GRID, reserve=True)
        # Speeds in m/s are far below 1, where infeasible profiles begin.
        return -found.mean_speed if found.feasible else 1.0 + min(found.excess, 1e9)

    # Durations and P2 / V1 by their logarithm.
    bounds = np.array([*np.log10(DURATIONS), V1_RANGE, np.log10(P2_SHARE)])
    candidates = [(PROPOSED.times, V1, P2), *((each.times, each.V1, each.P2) for each in known)]
    points = [
        np.clip([*np.log10(np.diff([0.0, *times])), peak, math.log10(second / peak)], *bounds.T)
        for times, peak, second in candidates
    ]
    settings = {
        "x0": min(points, key=objective),
        "maxiter": generations,
        "popsize": members,
        "seed": seed,
    }
    result = differential_evolution(
        objective, bounds, **settings, tol=0.0, init="sobol", polish=False
    )
    # In finer steps a member of the last generation may be infeasible: then the next best is taken.
    order = np.argsort(result.population_energies)
    solutions = [assess(problem, *_decode(result.population[i], problem)) for i in order]
    best = next((each for each in solutions if each.feasible), solutions[0])
    return replace(best, found_by=f"{problem.label}, seed {seed}")


def exchange(solutions: Sequence[Solution]) -> list[Solution]:
    """Gives each problem the best profile of any search, so that an incomplete search does not look
    like an effect.
    """
    exchanged = []
    for own in solutions:
        found = [
            replace(assess(own.problem, s.times, s.V1, s.P2), found_by=s.found_by)
            for s in solutions
        ]
        exchanged.append(min([own, *found], key=lambda each: (each.excess, -each.mean_speed)))
    return exchanged


def load(path: Path = OPTIMA) -> list[Solution]:
    """Reads the solutions that the command has written."""
    rows = json.loads(path.read_text(encoding="utf-8"))["solutions"]
    return [
        Solution(
            **{**row, "problem": ProfileProblem(**row["problem"]), "times": tuple(row["times"])}
        )
        for row in rows
    ]


@command(PROG, ValueError)
def main(
    json: Path = OPTIMA, seed: int = 0, generations: int = 200, overwrite: bool = False
) -> None:
    """Optimises the paper's profile (9) for speed, under exact tracking, Principles 1 to 4 and a
    torque limit.

    About half an hour on one core.

    Examples:
      python -m baselines.paper.optimal_profiles --json mine.json                     solve all
      problems python -m baselines.paper.optimal_profiles --json short.json --generations 5    a
      short search

    Args:
        json: File of the results.
        seed: Seed of the searches.
        generations: Generations of each search.
        overwrite: Replace an existing file.
    """
    check_output("--json", json, overwrite=overwrite)
    solutions: list[Solution] = []
    for problem in problems():
        solutions.append(search(problem, solutions, seed=seed, generations=generations))
        print(f"{problem.label}: {solutions[-1].mean_speed:.5f} m/s", flush=True)
    document = {
        "command": f"{PROG} --seed {seed} --generations {generations}",
        "bounds": dict(zip(("theta_0", "v_theta", "a_theta"), BOUNDS.tolist(), strict=True)),
        "solutions": [asdict(each) for each in exchange(solutions)],
    }
    write_atomically(json, to_json(document))
    print(f"{len(solutions)} solutions written to {json}")


if __name__ == "__main__":
    sys.exit(main())
