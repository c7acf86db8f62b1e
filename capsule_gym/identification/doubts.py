"""Reasons to doubt the result of an identification."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from capsule_gym.identification.ranges import RANGES
from capsule_gym.identification.result import OPEN, Fit
from capsule_gym.identification.shooting import ShootingProblem

LARGEST_CHI2 = 1.2
# The reduction of the sum of squares behind an end of a range that is no chance: three deviations.
PUSH = 9.0
# Deviations by which, and s by which, the readings of a sensor are later than those of another.
LATE = 5.0
SHORTEST_LATENESS = 2e-3
# Range, s, of the latency of a sensor that is looked for.
SEARCHED = 0.1


def doubts(fit: Fit, problem: ShootingProblem, found: np.ndarray) -> Iterator[str]:
    """The reasons to doubt a result; `found` are the unknowns of largest likelihood."""
    if fit.chi2 > LARGEST_CHI2:
        yield (
            f"chi2 is {fit.chi2:.2f}: the model does not explain the log, "
            "and the intervals are too short"
        )
    if not {"x", "x_dot"} & set(problem.sensors):
        yield "log has neither x nor x_dot: the intervals of M, mu, m, l and k may be too short"
    # The table shows what else is open.
    wide = [name for name, width in fit.widths.items() if width > OPEN]
    undetermined = [name for name in wide if name not in RANGES]
    if undetermined:
        names = ", ".join(undetermined)
        yield f"the log does not determine {names}: the intervals are the prior's"
    yield from doubts_of_clocks(problem, found)
    yield from doubts_of_ranges(problem, found)


def doubts_of_ranges(problem: ShootingProblem, found: np.ndarray) -> Iterator[str]:
    """Names the quantities that a log draws beyond the ends of their ranges."""
    at_end: list[str] = []
    impossible: list[str] = []
    for n in drawn_beyond(problem, found):
        name = problem.names[n]
        smallest = 1.0 if name == "static_ratio" else 0.0
        low, _ = problem.ranges[name]
        lists = impossible if found[n] == 0.0 and low == smallest else at_end
        lists.append(name)
    if at_end:
        yield (
            f"{', '.join(at_end)} lies at the end of its range: give a wider one, "
            f"such as ranges={{{at_end[0]!r}: (low, high)}}"
        )
    if impossible:
        yield (
            f"the log draws {', '.join(impossible)} below the smallest possible value: "
            "a column may be shifted by a row, or have another sign"
        )


def drawn_beyond(problem: ShootingProblem, found: np.ndarray) -> list[int]:
    """The unknowns behind whose ends the sum of squares would be far smaller."""
    gradient, normal = _derivatives(problem, found)
    free = problem.free(found, gradient)
    inverse = _inverse(normal, free)
    beyond = []
    for n in np.flatnonzero(~free):
        others = normal[free, n]
        curvature = normal[n, n] - others @ inverse @ others
        if gradient[n] ** 2 > PUSH * curvature:
            beyond.append(int(n))
    return beyond


def _derivatives(problem: ShootingProblem, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The gradient of half the sum of squares, and Gauss and Newton's matrix of its curvature."""
    r, jacobian = problem.residuals(unknowns)
    return jacobian.T @ r, jacobian.T @ jacobian


def _inverse(normal: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The inverse of this matrix among the unknowns that are not at an end of their range."""
    return np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)


def doubts_of_clocks(problem: ShootingProblem, found: np.ndarray) -> Iterator[str]:
    """Names the sensors whose readings are later than those of others."""
    values, _ = problem.values(found[: len(problem.names)])
    own = [f"{name}_latency" for name in problem.sensors]
    kept = [n for n, name in enumerate(problem.names) if name not in ("latency", *own)]
    ranges = {problem.names[n]: problem.ranges[problem.names[n]] for n in kept}
    latest = {name: (values.get(name, 0.0), values.get(name, 0.0) + SEARCHED) for name in own}
    known = {**problem.known, "latency": values["latency"]}
    apart = replace(problem, ranges={**ranges, **latest}, known=known)
    apart.lead = problem.lead
    states = found[len(problem.names) :]
    unknowns = np.concatenate([found[kept], np.zeros(len(own)), states])
    gradient, normal = _derivatives(apart, unknowns)
    free = apart.free(unknowns, gradient)
    places = len(kept) + np.arange(len(own))
    free[places] = True
    inverse = _inverse(normal, free)
    places = np.cumsum(free)[places] - 1
    delays = -SEARCHED * (inverse @ gradient[free])[places]
    covariance = SEARCHED**2 * inverse[np.ix_(places, places)]
    first = delays.argmin()
    for n, name in enumerate(problem.sensors):
        late = delays[n] - delays[first]
        variance = covariance[n, n] + covariance[first, first] - 2.0 * covariance[n, first]
        if late > max(SHORTEST_LATENESS, LATE * variance**0.5):
            advice = f"ranges={{{own[n]!r}: (0.0, {2.0 * late:.2g})}}"
            if name == "x":
                advice = "a shift of the column"
            yield (
                f"column {name!r} is about {1e3 * late:.0f} ms later than column "
                f"{problem.sensors[first]!r}: give {advice}"
            )
