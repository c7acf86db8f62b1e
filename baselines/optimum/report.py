"""The tables of the optimum: refinement, hold, and the front of speed against cost, from what is on file."""

from __future__ import annotations

from baselines.gaits.archive import GRID_M, GRID_MU, pareto_front
from baselines.optimum.records import Archive, Record, key_of
from baselines.optimum.solver import Problem
from baselines.tables import markdown_table
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import CONTROL_DT


def extrapolated(record: Record) -> tuple[float, float]:
    """Where the gains of ever finer grids lead, cm/s: were the last two's error of second order, and of first.

    Args:
        record: with two grids or more.
    """
    coarse, fine = (shape[0] - 1 for shape in record.grids[-2:])
    before, last = record.gains[-2:]
    ratio = fine / coarse
    second, first = (last + (last - before) / (ratio**order - 1.0) for order in (2, 1))
    return second, first


def refinement_table(archive: Archive) -> str:
    """The nominal plant on ever finer grids."""
    record = archive.records[key_of(Problem())]
    rows = [["grid", "nodes", "gain (cm/s)", "steady speed of its motion (cm/s)"]]
    for shape, gain, steady in zip(record.grids, record.gains, record.steady, strict=True):
        nodes = shape[0] * shape[1] * shape[2]
        rows.append([" x ".join(map(str, shape)), f"{nodes:,}", f"{gain:.2f}", f"{steady:.2f}"])
    second, first = extrapolated(record)
    rows.append(["extrapolated", "", f"{second:.2f} to {first:.2f}", ""])
    return markdown_table(rows)


def hold_table(archive: Archive) -> str:
    """The nominal plant with the torque held for different times."""
    rows = [["hold (ms)", "speed over 33 s (cm/s)", "steady speed (cm/s)", "gain (cm/s)", "extrapolated (cm/s)"]]
    for record in sorted(archive.records.values(), key=lambda r: -r.hold):
        if record.problem == Problem(hold=record.hold):
            second, first = extrapolated(record)
            speeds = [f"{v:.2f}" for v in (record.mean_speed, max(record.steady), record.gains[-1])]
            rows.append([f"{1e3 * record.hold:g}", *speeds, f"{second:.2f} to {first:.2f}"])
    return markdown_table(rows)


def front_table(archive: Archive) -> str:
    """The front of speed against cost of transport, beside the gaits that are at least as fast."""
    gaits = pareto_front()
    rows = [["a joule costs (cm)", "speed over 33 s (cm/s)", "cost of transport", "cheapest gait of that speed"]]
    for record in sorted(archive.records.values(), key=lambda r: r.energy_weight):
        if record.problem == Problem(energy_weight=record.energy_weight) and record.cost_of_transport is not None:
            known = min((g.cost_of_transport for g in gaits if g.mean_speed >= record.mean_speed), default=None)
            transport = "-" if known is None else f"{known:.2f}"
            weight, cost = f"{record.energy_weight:g}", f"{record.cost_of_transport:.2f}"
            rows.append([weight, f"{record.mean_speed:.2f}", cost, transport])
    return markdown_table(rows)


def speed_table(archive: Archive) -> str:
    """The speeds over the grid of plants."""
    rows = [["M (kg) \\ mu", *(f"{mu:g}" for mu in GRID_MU)]]
    for M in GRID_M:
        speeds = (archive.records[key_of(Problem(M=M, mu=mu))].mean_speed for mu in GRID_MU)
        rows.append([f"{M:g}", *(f"{speed:.2f}" for speed in speeds)])
    return markdown_table(rows)


def report(archive: Archive) -> str:
    """All tables, with headings."""
    plant = f"M = {NOMINAL.M:g} kg, mu = {NOMINAL.mu:g}"
    return "\n\n".join(
        [
            f"Ever finer grids ({plant}, hold {1e3 * CONTROL_DT:g} ms)",
            refinement_table(archive),
            f"Other holds ({plant})",
            hold_table(archive),
            f"Speed against cost ({plant})",
            front_table(archive),
            "Speed over 33 s (cm/s)",
            speed_table(archive),
        ]
    )
