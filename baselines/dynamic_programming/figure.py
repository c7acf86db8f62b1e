"""The figure of the solution on the nominal plant, and the tables of the archive, for the page about the optimum."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np

from baselines.archive import GRID, STICKY_GRID
from baselines.drawing import BLUE, GREEN, INK, MUTED, VERMILION, add_note, new_figure
from baselines.dynamic_programming.archive import SETS, Archive, Result, cycle, known_results, set_plants
from baselines.dynamic_programming.problem import (
    ACTIONS,
    CONTROL_INTERVALS,
    ENERGY_WEIGHTS,
    Problem,
    Transitions,
    plant_problems,
)
from baselines.dynamic_programming.solver import Solution
from baselines.tables import markdown_table
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import TORQUE_LIMIT

Cycle = dict[str, np.ndarray]

# Points of the maps along either axis, and the range of the rates, rad/s.
POINTS = 141
RATES = (-8.0, 14.0)
THETA = 1.55
# cm: states with a smaller value count as failures; range of the coloured values.
FAILING = -20.0
SHOWN = 16.0


def draw_optimum() -> Any:
    """Draws the figure; to be called within `baselines.drawing.style`."""
    solution, own = known_results().solution(Problem()), cycle()
    q = solution.grid.q
    w = float(np.median(own["x_dot"] / q - np.cos(own["theta"]) * own["theta_dot"]))
    figure = new_figure(5.6)
    (value, torque), (motion, force) = figure.subplots(2, 2, height_ratios=(1.35, 1.0))
    values, torques = _maps(solution, w)
    top, limit, failing = float(values.max()), TORQUE_LIMIT, values < FAILING
    _draw_map(figure, value, np.where(failing, np.nan, values), own, "viridis", "value (cm)", (top - SHOWN, top))
    value.set_title("Value of a state, relative to the start")
    _draw_map(figure, torque, np.where(failing, np.nan, torques), own, "RdBu_r", "torque (N m)", (-limit, limit))
    torque.set_title("The best torque")
    motion.plot(own["time"], own["theta"], color=BLUE, label="θ (rad)")
    motion.plot(own["time"], own["x_dot"], color=VERMILION, label="x' (m/s)")
    _draw_cycle(motion, own, "Pendulum and platform", (-0.8, 1.3))
    weight = (NOMINAL.M + NOMINAL.m) * NOMINAL.g
    force.step(own["time"], own["torque"], where="post", color=GREEN, label="u (N m)")
    force.plot(own["time"], own["normal_force"] / weight, color=INK, label="N / (M + m) g")
    _draw_cycle(force, own, "Torque and contact", (-1.7, 2.3))
    add_note(
        figure,
        f"Nominal plant, control interval 20 ms. Maps: the slice where the centre of mass moves at {100.0 * q * w:.1f} "
        "cm/s, its median over the cycle; grey: failure. Black: the cycle, which begins at the dot. Shaded: the "
        "platform slides backwards, and friction pushes the capsule forwards. Period "
        f"{own['time'][-1]:.2f} s, {100.0 * own['x'][-1] / own['time'][-1]:.1f} cm/s.",
    )
    return figure


def _maps(solution: Solution, w: float) -> tuple[np.ndarray, np.ndarray]:
    """Values in cm and best torques in N m over theta (columns) and theta_dot (rows), at one w in rad/s."""
    theta, theta_dot = np.meshgrid(np.linspace(-THETA, THETA, POINTS), np.linspace(*RATES, POINTS))
    x_dot = solution.grid.q * (w + np.cos(theta) * theta_dot)
    states = np.stack([theta.ravel(), theta_dot.ravel(), x_dot.ravel()])
    model = Transitions(solution.problem, states.shape[1])
    best, torques = np.full(states.shape[1], -np.inf), np.zeros(states.shape[1])
    # Every third torque is fine enough for a map.
    for action in ACTIONS[::3]:
        ends, rewards, failed = model.step(states, np.full(best.size, action))
        scores = np.where(failed, -np.inf, rewards + solution.at(ends))
        torques = np.where(scores > best, TORQUE_LIMIT * action, torques)
        best = np.maximum(best, scores)
    return best.reshape(theta.shape), torques.reshape(theta.shape)


def _draw_map(
    figure: Any, axes: Any, image: np.ndarray, own: Cycle, colours: str, label: str, limits: tuple[float, float]
) -> None:
    """Draws a map and the cycle on top of it."""
    axes.set_facecolor("#d9d9d9")
    options = {"origin": "lower", "aspect": "auto", "interpolation": "nearest", "cmap": colours, "clim": limits}
    shown = axes.imshow(image, extent=(-THETA, THETA, *RATES), **options)
    below = np.nanmin(image) < limits[0]
    figure.colorbar(shown, ax=axes, label=label, pad=0.02, extend="min" if below else "neither")
    axes.plot(own["theta"], own["theta_dot"], color=INK, lw=1.4)
    axes.plot(own["theta"][0], own["theta_dot"][0], "o", color=INK, markersize=4.0)
    axes.grid(False)
    axes.set(xlabel="θ (rad)", ylabel="θ' (rad/s)", xlim=(-THETA, THETA), ylim=RATES)


def _draw_cycle(axes: Any, own: Cycle, title: str, limits: tuple[float, float]) -> None:
    """Draws the frame of a panel over the cycle; shades the times at which the platform slides backwards."""
    backwards = own["x_dot"] < 0.0
    axes.fill_between(own["time"], *limits, where=backwards, step="post", color="#e8eef6", lw=0.0, zorder=0.5)
    axes.axhline(0.0, color=MUTED, lw=0.6)
    axes.set(title=title, xlim=(0.0, own["time"][-1]), ylim=limits, xlabel="time in the cycle (s)")
    axes.legend(loc="upper right", ncols=2, handlelength=1.5, columnspacing=1.2)


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
