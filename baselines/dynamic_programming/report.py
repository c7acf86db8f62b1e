"""The tables of what is on file: finer grids, control intervals, energy weights and plants."""

from __future__ import annotations

from baselines.archive import GRID_M, GRID_MU
from baselines.dynamic_programming.archive import Archive, Result, key_of
from baselines.dynamic_programming.problem import Problem
from baselines.gaits.archive import pareto_front
from baselines.tables import markdown_table
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import CONTROL_DT


def extrapolated(result: Result) -> str:
    """The limit of the gains on ever finer grids, cm/s, for errors of second and of first order."""
    ratio = (result.grids[-1][0] - 1) / (result.grids[-2][0] - 1)
    before, last = result.gains[-2:]
    return " to ".join(f"{last + (last - before) / (ratio**order - 1.0):.2f}" for order in (2, 1))


def report(archive: Archive) -> str:
    """All tables, with headings."""
    plant, results = f"M = {NOMINAL.M:g} kg, mu = {NOMINAL.mu:g}", archive.results
    nominal = results[key_of(Problem())]
    grids = [["grid", "nodes", "gain (cm/s)", "steady speed of its trajectory (cm/s)"]]
    for shape, gain, steady in zip(nominal.grids, nominal.gains, nominal.steady, strict=True):
        nodes = shape[0] * shape[1] * shape[2]
        grids.append([" x ".join(map(str, shape)), f"{nodes:,}", f"{gain:.2f}", f"{steady:.2f}"])
    grids.append(["extrapolated", "", extrapolated(nominal), ""])

    intervals = [
        ["interval (ms)", "speed over 33 s (cm/s)", "steady speed (cm/s)", "gain (cm/s)", "extrapolated (cm/s)"]
    ]
    for each in sorted(results.values(), key=lambda r: -r.control_dt):
        if each.problem == Problem(control_dt=each.control_dt):
            numbers = [f"{value:.2f}" for value in (each.mean_speed, max(each.steady), each.gains[-1])]
            intervals.append([f"{1e3 * each.control_dt:g}", *numbers, extrapolated(each)])

    weights = [["energy weight (cm/J)", "speed over 33 s (cm/s)", "cost of transport", "cheapest gait of that speed"]]
    for each in sorted(results.values(), key=lambda r: r.energy_weight):
        if each.problem == Problem(energy_weight=each.energy_weight) and each.cost_of_transport is not None:
            costs = [gait.cost_of_transport for gait in pareto_front() if gait.mean_speed >= each.mean_speed]
            cheapest = f"{min(costs):.2f}" if costs else "-"
            numbers = [f"{each.energy_weight:g}", f"{each.mean_speed:.2f}", f"{each.cost_of_transport:.2f}"]
            weights.append([*numbers, cheapest])

    plants = [["M (kg) \\ mu", *(f"{mu:g}" for mu in GRID_MU)]]
    for M in GRID_M:
        plants.append([f"{M:g}", *(f"{results[key_of(Problem(M=M, mu=mu))].mean_speed:.2f}" for mu in GRID_MU)])
    parts = (
        (f"Finer grids ({plant}, control interval {1e3 * CONTROL_DT:g} ms)", grids),
        (f"Control intervals ({plant})", intervals),
        (f"Speed against cost ({plant})", weights),
        ("Speed over 33 s (cm/s)", plants),
    )
    return "\n\n".join(f"{heading}\n\n{markdown_table(rows)}" for heading, rows in parts)
