"""The tables of the archive, for the page about dynamic programming."""

from __future__ import annotations

from itertools import islice

import numpy as np

from baselines.dynamic_programming.archive import SETS, Archive, Result, known_results, set_plants
from baselines.dynamic_programming.problem import (
    CONTROL_INTERVALS,
    ENERGY_WEIGHTS,
    GRID,
    STICKY_GRID,
    Problem,
    plant_problems,
)
from baselines.tables import markdown_table


def optimal_front() -> list[tuple[float, float]]:
    """The undominated costs of transport and mean speeds (cm/s) of the energy weights, nominal plant, slowest first."""
    results = known_results().results
    own = [results[Problem(energy_weight=weight).key] for weight in (0.0, *ENERGY_WEIGHTS)]
    found = [(each.cost_of_transport, each.mean_speed) for each in own]
    undominated = [(cost, speed) for cost, speed in found if not any(c <= cost and s > speed for c, s in found)]
    return sorted(undominated, key=lambda point: point[1])


def extrapolated(result: Result) -> str:
    """The limit of the gains on ever finer grids, cm/s, for errors of second and of first order."""
    ratio = (result.grids[-1][0] - 1) / (result.grids[-2][0] - 1)
    before, last = result.gains[-2:]
    return " to ".join(f"{last + (last - before) / (ratio**order - 1.0):.2f}" for order in (2, 1))


def report(archive: Archive) -> str:
    """All tables, with headings."""
    results = archive.results
    nominal = results[Problem().key]
    grids = [["grid", "nodes", "gain (cm/s)", "steady speed of its trajectory (cm/s)"]]
    for shape, gain, steady in zip(nominal.grids, nominal.gains, nominal.steady, strict=True):
        nodes = shape[0] * shape[1] * shape[2]
        grids.append([" x ".join(map(str, shape)), f"{nodes:,}", f"{gain:.2f}", f"{steady:.2f}"])
    grids.append(["extrapolated", "", extrapolated(nominal), ""])

    speed = "speed over 33 s (cm/s)"
    intervals = [["interval (ms)", speed, "steady speed (cm/s)", "gain (cm/s)", "extrapolated (cm/s)"]]
    for each in (nominal, *(results[Problem(control_dt=control_dt).key] for control_dt in CONTROL_INTERVALS)):
        numbers = [f"{value:.2f}" for value in (each.mean_speed, max(each.steady), each.gains[-1])]
        intervals.append([f"{1e3 * each.control_dt:g}", *numbers, extrapolated(each)])

    weights = [["energy weight (cm/J)", speed, "cost of transport"]]
    for each in (nominal, *(results[Problem(energy_weight=weight).key] for weight in ENERGY_WEIGHTS)):
        weights.append([f"{each.energy_weight:g}", f"{each.mean_speed:.2f}", f"{each.cost_of_transport:.2f}"])

    sets = [["set", "plants", "slowest (cm/s)", "fastest (cm/s)", "interpolated over solved, mean", "from", "to"]]
    for name in SETS:
        own = set_plants(name)
        solved = np.array([archive.plant_speeds[plant] for plant in own])
        ratios = 100.0 * np.array([archive.interpolated_speed(*plant) for plant in own]) / solved - 100.0
        numbers = [f"{speed:.2f}" for speed in (solved.min(), solved.max())]
        shares = [f"{share:+.1f} %" for share in (ratios.mean(), ratios.min(), ratios.max())]
        sets.append([f"`{name}`", str(len(own)), *numbers, *shares])

    parts = {
        "Finer grids": grids,
        "Control intervals": intervals,
        "Energy weights": weights,
        "Plants of the sets": sets,
    }
    for grid in (GRID, STICKY_GRID):
        table = [["M (kg) \\ mu", *(f"{mu:g}" for mu in grid.mu)]]
        speeds = iter(f"{results[problem.key].mean_speed:.2f}" for problem in plant_problems(grid))
        table += [[f"{M:g}", *islice(speeds, len(grid.mu))] for M in grid.M]
        parts[f"Plants with a static ratio of {grid.static_ratio:g} (cm/s)"] = table
    return "\n\n".join(f"{heading}\n\n{markdown_table(rows)}" for heading, rows in parts.items())
