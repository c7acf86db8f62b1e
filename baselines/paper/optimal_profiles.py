"""The paper's 'optimal trajectory' made true: the seven-phase profile (9) whose parameters are optimal, not selected.

    python -m baselines.paper.optimal_profiles            searches and writes optimal_profiles.json beside this file
    python -m baselines.paper.optimal_profiles --check    assesses what that file holds again, writes nothing

Free are the seven times, V1 and P2 (P3 closes the cycle) and, where a problem says so, the angle at the start. The aim
is the mean speed under exact tracking, subject to a torque limit and Principles 1 to 4. Their bounds are not published,
so the published profile's own largest angle, velocity and acceleration bound the others, which makes it one of the
candidates. Principle 4 comes in the readings of `STANDSTILLS`.

A search is differential evolution, seeded, on one core, and what one finds serves all others. With other seeds speeds
come out up to 1.5 % apart, and some 15 % where Principle 4 binds phase IV: they are lower bounds of the optimum. Ctrl-C
keeps the problems solved so far, and the next call solves the rest.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from baselines.laws.profiles import P2, PROPOSED, V1, Profile, seven_phases
from baselines.paper.exact_tracking import STANDSTILLS, Assessment, Demands, assess, published_bounds
from baselines.paper.published import M_RANGE, MU_RANGE
from capsule_gym.files import write_atomically
from capsule_gym.parameters import Capsule, Plant
from capsule_gym.task import START_THETA

DATA = Path(__file__).with_name("optimal_profiles.json")

TORQUE_LIMITS = (0.54, 1.0, 1.5)
GENERATIONS = 200
MEMBERS_PER_PARAMETER = 10
SEED = 0
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


@dataclass(frozen=True)
class Problem:
    """One optimisation.

    Attributes:
        torque_limit: N m.
        plants: "nominal", or "ranges" for the worst plant of the paper's ranges.
        dropped: number of the principle that is left out, 0 for none.
        standstill: reading of Principle 4, a key of `STANDSTILLS`.
        free_start: whether the angle at the start is free; else it is the paper's -pi/3.
    """

    torque_limit: float
    plants: str = "nominal"
    dropped: int = 0
    standstill: str = "return"
    free_start: bool = False

    @property
    def label(self) -> str:
        """For tables and progress."""
        parts = [f"{self.torque_limit:g} N m", self.plants]
        parts += [f"without Principle {self.dropped}"] if self.dropped else []
        parts += [f"Principle 4: {self.standstill}"] if self.standstill != "return" else []
        parts += ["start free"] if self.free_start else []
        return ", ".join(parts)

    def demands(self) -> Demands:
        """Its constraints."""
        demands = Demands(self.torque_limit, *published_bounds(), True, STANDSTILLS[self.standstill])
        velocity_and_acceleration = {"v_theta": None, "a_theta": None}
        left_out: tuple[dict[str, Any], ...]
        left_out = ({}, {"theta_0": None}, velocity_and_acceleration, {"contact": False}, {"standstill": None})
        return replace(demands, **left_out[self.dropped])

    def plant_list(self) -> list[Plant]:
        """The plants that it is judged on."""
        capsule = Capsule()
        if self.plants == "nominal":
            return [capsule.plant()]
        # Speed and demands are monotonic enough for the corners; a test looks between them.
        return [capsule.plant(M, mu) for M in M_RANGE for mu in MU_RANGE]


@dataclass(frozen=True)
class Solution:
    """What a search found.

    Attributes:
        problem: what was asked.
        times: t1 to t7, s.
        V1: rad/s.
        P2: rad/s.
        start: rad.
        feasible: whether it meets every demand; where not, it is the nearest that the search came.
        mean_speed: of the worst plant, m/s.
        cost_of_transport: of the worst plant; None where it gets nowhere.
        peak_torque: of the worst plant, N m.
        backward_ratio: distance backwards over forwards on the worst plant; None where it only moves backwards.
        shares: load over limit by demand, on the worst plant.
        found_by: the problem and the seed of the search that it comes from.
        evaluations: profiles that the problem's own search looked at.
        seconds: that it took.
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
        excess = sum(max(0.0, share - 1.0) for share in self.shares.values())
        return (0.0 if self.feasible else excess), -self.mean_speed

    @property
    def profile(self) -> Profile:
        """The profile itself."""
        name = "optimal" if self.feasible else "infeasible"
        return replace(seven_phases(self.times, self.V1, self.P2, name), start=self.start)

    def assess(self) -> Assessment:
        """Judges it anew."""
        return assess(self.profile, self.problem.demands(), self.problem.plant_list())


def problems() -> list[Problem]:
    """All that the command solves, each after those whose solutions it can start from."""
    variants: list[dict[str, Any]] = [{}, *({"dropped": n} for n in (1, 2, 3, 4)), {"free_start": True}]
    variants += [{"standstill": "strict-return"}, {"plants": "ranges"}]
    # From -pi/3 the spring's torque alone, which (8) counts as a force, exceeds the static friction three times.
    variants += [{"standstill": "printed", "free_start": True}, {"standstill": "restoring"}]
    return [Problem(limit, **variant) for variant in variants for limit in TORQUE_LIMITS]


def _decode(z: np.ndarray, problem: Problem) -> tuple[tuple[float, ...], float, float, float]:
    """Times, V1, P2 and start of a point of the search space."""
    durations = np.maximum(1.0, np.rint(10.0 ** np.asarray(z[:7]) / GRID))
    times = tuple(float(t) for t in np.round(np.cumsum(durations) * GRID, 3))
    v_theta = problem.demands().v_theta
    V1 = float(z[7]) if v_theta is None else min(float(z[7]), v_theta)
    return times, V1, V1 * float(10.0 ** z[8]), float(z[9]) if problem.free_start else START_THETA


def _encode(times: Sequence[float], V1: float, P2: float, start: float) -> np.ndarray:
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
) -> Solution:
    """Solves one problem by differential evolution: feasible profiles by speed, before all others by violation.

    Args:
        problem: what to solve.
        known: solutions of other problems; the best for this one joins the first generation. Without any, the
            published profile does.
        seed: of the search.
        generations: that the search goes through.
        members: of a generation, per parameter.

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
    published = _encode(tuple(PROPOSED.times), V1, P2, START_THETA)
    starts = [published, *(_encode(each.times, each.V1, each.P2, each.start) for each in known)]
    x0 = min(starts, key=aim)
    found = []
    for restart in range(seed, seed + RESTARTS.get(problem.standstill, 1)):
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


def load(path: Path = DATA) -> list[Solution]:
    """The solutions of a file.

    Args:
        path: as `python -m baselines.paper.optimal_profiles` writes it; the committed one by default.
    """
    document = json.loads(path.read_text(encoding="utf-8"))
    solutions = []
    for entry in document["solutions"]:
        fields = {**entry, "problem": Problem(**entry["problem"]), "times": tuple(entry["times"])}
        solutions.append(Solution(**fields))
    return solutions


def save(solutions: Sequence[Solution], path: Path, seed: int, generations: int) -> None:
    """Writes solutions with the searches' seed, generations, command and seconds."""
    document = {
        "command": f"python -m baselines.paper.optimal_profiles --seed {seed} --generations {generations}",
        "seed": seed,
        "generations": generations,
        "seconds": round(sum(each.seconds for each in solutions), 1),
        "bounds": dict(zip(("theta_0", "v_theta", "a_theta"), published_bounds(), strict=True)),
        "solutions": [asdict(each) for each in solutions],
    }
    write_atomically(path, json.dumps(document, indent=1) + "\n")


def _settings(path: Path) -> tuple[int, int]:
    """Seed and generations of the searches whose solutions a file holds."""
    document = json.loads(path.read_text(encoding="utf-8"))
    return document["seed"], document["generations"]


def check(solutions: Sequence[Solution]) -> list[str]:
    """Assesses solutions again and says where they are not what they claim.

    Args:
        solutions: as `load` gives them.
    """
    wrong = []
    for each in solutions:
        again = each.assess()
        if again.feasible != each.feasible:
            wrong.append(f"{each.problem.label}: feasible {again.feasible}, recorded {each.feasible}: {again.shares}")
        if not math.isclose(again.mean_speed, each.mean_speed, rel_tol=1e-6):
            wrong.append(f"{each.problem.label}: speed {again.mean_speed}, recorded {each.mean_speed}")
    return wrong


def format_row(solution: Solution) -> str:
    """One line of the command's table."""
    if not solution.feasible:
        return f"{solution.problem.label:<52} none found, nearest exceeds {_binding(solution, 1.0)}"
    cost = math.inf if solution.cost_of_transport is None else solution.cost_of_transport
    return (
        f"{solution.problem.label:<52} {100 * solution.mean_speed:6.3f} cm/s {cost:6.2f} "
        f"{solution.peak_torque:6.3f} N m  reaches {_binding(solution, 0.98)}"
    )


def _binding(solution: Solution, share: float) -> str:
    """The demands at or above a share of their limit."""
    named = [f"{name} {value:.3f}" for name, value in solution.shares.items() if value >= share]
    return ", ".join(named) or "none"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="python -m baselines.paper.optimal_profiles", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--json", type=Path, default=DATA, metavar="FILE", help="where the results are (%(default)s)")
    parser.add_argument("--seed", type=int, default=SEED, help="of the searches (%(default)s)")
    parser.add_argument("--generations", type=int, default=GENERATIONS, help="of each search (%(default)s)")
    parser.add_argument("--again", action="store_true", help="solve again what the file holds")
    parser.add_argument("--check", action="store_true", help="assess what the file holds, search nothing")
    options = parser.parse_args(arguments)
    solved = load(options.json) if options.json.exists() and (options.check or not options.again) else []
    if options.check:
        wrong = check(solved)
        print(*(format_row(each) for each in solved), *wrong, sep="\n")
        return 1 if wrong or not solved else 0
    if solved and _settings(options.json) != (options.seed, options.generations):
        parser.error(f"{options.json} holds searches with another seed or number of generations; --again replaces them")
    every = problems()
    missing = [problem for problem in every if problem not in {each.problem for each in solved}]
    try:
        for number, problem in enumerate(missing, start=1):
            solution = search(problem, solved, seed=options.seed, generations=options.generations)
            solved.append(solution)
            print(f"{number}/{len(missing)} {format_row(solution)} ({solution.seconds:.0f} s)", flush=True)
            save(solved, options.json, options.seed, options.generations)
    except KeyboardInterrupt:
        print(f"interrupted; {options.json} holds {len(solved)} of {len(every)} problems", file=sys.stderr)
        return 130
    solved = exchange(sorted(solved, key=lambda each: every.index(each.problem)))
    save(solved, options.json, options.seed, options.generations)
    print("\nThe best of all searches for each problem:", *(format_row(each) for each in solved), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
