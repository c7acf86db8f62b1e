"""The solutions of `python -m baselines.paper.optimal_profiles`: their file, and what it lacks searched for."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from baselines.paper.exact_tracking import published_bounds
from baselines.paper.profile_problems import Problem, Solution, problems
from baselines.paper.profile_search import Spread, exchange, search, search_again, spread_problems
from baselines.paper.profile_settings import DATA, PROG
from baselines.tables import printed_below
from capsule_gym.files import to_json, write_atomically


@dataclass(frozen=True)
class Found:
    """What a file of searches holds.

    Attributes:
        seed: of the searches.
        generations: that each went through.
        solutions: one per problem.
        spreads: what searches with other seeds found.
    """

    seed: int
    generations: int
    solutions: tuple[Solution, ...]
    spreads: tuple[Spread, ...] = ()

    def against(self, spread: Spread) -> tuple[float, float]:
        """The slowest and the fastest of some further searches over the solution of their problem, minus 1."""
        stored = next(each.mean_speed for each in self.solutions if each.problem == spread.problem)
        return min(spread.feasible) / stored - 1.0, max(spread.feasible) / stored - 1.0


def load(path: Path = DATA) -> Found:
    """The searches of a file.

    Args:
        path: as `python -m baselines.paper.optimal_profiles` writes it; the committed one by default.
    """
    document = json.loads(path.read_text(encoding="utf-8"))

    def read(kind: Any, entry: dict[str, Any], *sequences: str) -> Any:
        fields = {name: tuple(entry[name]) for name in sequences}
        return kind(**{**entry, **fields, "problem": Problem(**entry["problem"])})

    return Found(
        document["seed"],
        document["generations"],
        tuple(read(Solution, entry, "times") for entry in document["solutions"]),
        tuple(read(Spread, entry, "seeds", "speeds") for entry in document["spreads"]),
    )


def save(found: Found, path: Path) -> None:
    """Writes searches with their command and seconds."""
    document = {
        "command": f"{PROG} --seed {found.seed} --generations {found.generations}",
        "seed": found.seed,
        "generations": found.generations,
        "seconds": round(sum(each.seconds for each in found.solutions), 1),
        "bounds": dict(zip(("theta_0", "v_theta", "a_theta"), published_bounds(), strict=True)),
        "spreads": [asdict(each) for each in found.spreads],
        "solutions": [asdict(each) for each in found.solutions],
    }
    write_atomically(path, to_json(document))


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
        f"{solution.problem.label:<52} {printed_below(100.0 * solution.mean_speed, 3):>6} cm/s {cost:6.2f} "
        f"{solution.peak_torque:6.3f} N m  reaches {_binding(solution, 0.98)}"
    )


def _binding(solution: Solution, share: float) -> str:
    """The demands at or above a share of their limit."""
    named = [f"{name} {value:.3f}" for name, value in solution.shares.items() if value >= share]
    return ", ".join(named) or "none"


def format_spread(found: Found, spread: Spread) -> str:
    """One line on what other seeds found."""
    if not spread.feasible:
        return f"{spread.problem.label:<52} none of {len(spread.seeds)} found a profile"
    slowest, fastest = found.against(spread)
    return (
        f"{spread.problem.label:<52} {len(spread.feasible)} of {len(spread.seeds)} found one, "
        f"{100 * slowest:+.1f} to {100 * fastest:+.1f} % of the speed above"
    )


def solve(found: Found, path: Path) -> Found:
    """Solves the problems that are missing, saving after each, and lets what one search found serve all others."""
    every, solved = problems(), list(found.solutions)
    missing = [problem for problem in every if problem not in {each.problem for each in solved}]
    for number, problem in enumerate(missing, start=1):
        solution = search(problem, solved, seed=found.seed, generations=found.generations)
        solved.append(solution)
        print(f"{number}/{len(missing)} {format_row(solution)} ({solution.seconds:.0f} s)", flush=True)
        found = replace(found, solutions=tuple(solved))
        save(found, path)
    if missing:
        found = replace(found, solutions=tuple(exchange(sorted(solved, key=lambda each: every.index(each.problem)))))
        save(found, path)
    return found


def repeat(found: Found, path: Path) -> Found:
    """Makes the further searches that are missing, saving after each problem."""
    for problem in spread_problems():
        if problem not in {each.problem for each in found.spreads}:
            found = replace(found, spreads=(*found.spreads, search_again(problem, generations=found.generations)))
            print(format_spread(found, found.spreads[-1]), flush=True)
            save(found, path)
    return found
