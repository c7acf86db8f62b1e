"""The adaptive law (37) to (39) over the paper's ranges, open choices and long runs, and its Lyapunov function (40).

Two forms of the law run: regularised (`adaptive`), and corrected without regularisation (`adaptive_as_published`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.laws.adaptive import MEMORY, adaptive, eta_of, nominal_estimates, sliding_variables
from baselines.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED
from baselines.laws.profiles import PROPOSED
from baselines.paper.published import M_RANGE, MU_RANGE
from baselines.paper.tracking import CYCLES, UNLIMITED, Trajectory, make_simulation, simulate
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller
from capsule_gym.layout import Row
from capsule_gym.parameters import NOMINAL, Plant
from capsule_gym.simulation import Simulation
from capsule_gym.task import TORQUE_LIMIT

REGULARISED_LAW, CORRECTED_LAW = "regularised", "corrected, unregularised"
# |theta - theta_d| (rad), |theta' - theta_d'| (rad/s) and |delta_theta| (rad/s).
ERRORS = ("angle_error", "rate_error", "sliding")

GRID = 5
NOMINAL_PLANT = (NOMINAL.M, NOMINAL.mu)
CORNERS = list(itertools.product(M_RANGE, MU_RANGE))
# beta, eta(0) and n, which the paper leaves open, and the rate of the law in Hz.
BETAS, ETAS, EXPONENTS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0), (0.1, 0.3, 1.0), (1, 2, 3)
RATES = (1000, 2000, 5000, 10_000)
LONG, LONGEST = 60, 600
SHOWN_CYCLES = (1, 5, 10, 20, LONG, 200, LONGEST)


def sliding(run: Trajectory) -> Any:
    """The `Sliding` variables of (37), each an array over a run of the adaptive law with the published gains."""
    state, anchors = (run.theta, run.theta_dot, run.x, run.x_dot), run.memory[:, MEMORY.index("x_anchor")]
    return sliding_variables(state, anchors, run.reference.T, PUBLISHED)


def lyapunov(run: Trajectory, start: tuple[float, ...], plant: Plant) -> np.ndarray:
    """The Lyapunov function V of Eq. (40) at every call of a run of the adaptive law with the published gains.

    `start` is the law's memory before its first call; the parameters of `plant` are the true ones.
    """
    s, ml, n = sliding(run), plant.m * plant.l, REGULARISED.n
    # The memory of a sample is that after its call; the call itself used the one before.
    before = np.vstack([start, run.memory[:-1]])
    kinetic = 0.5 * (ml * plant.l * s.delta_theta**2 + (plant.M + plant.m) * s.delta_x**2)
    kinetic -= ml * np.cos(run.theta) * s.delta_theta * s.delta_x
    squares = (before[:, :9] - nominal_estimates(plant)) ** 2
    wrong = squares[:, :5].sum(axis=1) / PUBLISHED.Gamma_1 + squares[:, 5:].sum(axis=1) / PUBLISHED.Gamma_2
    return kinetic + 0.5 * wrong + (2.0 * n + 1.0) / (2.0 * n) * eta_of(before) ** (2.0 * n / (2.0 * n + 1.0))


@dataclass(frozen=True)
class LawStudy:
    """One form of the adaptive law, five cycles on each plant of the grid.

    Attributes:
        law: `REGULARISED_LAW` or `CORRECTED_LAW`.
        torque_limit: N m.
        runs: one per plant, M the slower index: `M` (kg), `mu`, `failed` (whether it ended early), `error_rms` of
            theta - theta_d (rad), `peak_velocity` (rad/s), `peak_torque` (N m), `mean_speed` (cm/s), and `eta` at its
            end.
        lyapunov: on the nominal plant and the corners of the ranges: V (40) at the first and last call (`start`,
            `end`), the fraction of the time in which it rises (`rising`), and the sums of all rises and falls (`rise`,
            `fall`).
    """

    law: str
    torque_limit: float
    runs: list[dict[str, Any]]
    lyapunov: list[dict[str, float]]

    @property
    def failures(self) -> int:
        """Number of runs that ended early."""
        return sum(run["failed"] for run in self.runs)

    def worst(self, quantity: str, *, smallest: bool = False) -> dict[str, Any]:
        """The run with the largest, or the smallest, value of one of its numbers."""
        return (min if smallest else max)(self.runs, key=lambda run: run[quantity])


def plant_grid() -> list[tuple[float, float]]:
    """The plants (M, mu) of the adaptive runs: 5 x 5 over the paper's ranges, corners and centre included."""
    masses, frictions = (np.linspace(*limits, GRID).tolist() for limits in (M_RANGE, MU_RANGE))
    return [(M, mu) for M in masses for mu in frictions]


def study_law(regularised: bool, torque_limit: float = UNLIMITED) -> LawStudy:
    """Runs one form of the adaptive law over the grid."""
    controller = adaptive(regularised=regularised)
    plants, runs, falls = plant_grid(), [], []
    # One run at a time: its memory takes 10 MB.
    for row in range(0, len(plants), GRID):
        batch = plants[row : row + GRID]
        for (M, mu), run in zip(batch, simulate(controller, batch, torque_limit=torque_limit), strict=True):
            values: dict[str, Any] = {"M": M, "mu": mu, "failed": not run.completed, "error_rms": run.error_rms}
            values |= {"peak_velocity": float(run.theta_dot.max()), "peak_torque": run.metrics["peak_torque"]}
            speed = 100.0 * run.metrics["distance"] / run.metrics["duration"]
            runs.append({**values, "mean_speed": speed, "eta": float(eta_of(run.memory[-1]))})
            if any(np.allclose((M, mu), plant, rtol=1e-9) for plant in (NOMINAL_PLANT, *CORNERS)):
                V = lyapunov(run, controller.memory, NOMINAL.plant(M, mu))
                change = np.diff(V)
                rises = np.where(change > 1e-12, change, 0.0)  # below is rounding
                fall, rising = float(np.abs(change[change < 0.0]).sum()), float((rises > 0.0).mean())
                ends = {"M": M, "mu": mu, "start": float(V[0]), "end": float(V[-1])}
                falls.append({**ends, "rising": rising, "rise": float(rises.sum()), "fall": fall})
    return LawStudy(REGULARISED_LAW if regularised else CORRECTED_LAW, torque_limit, runs, falls)


def run_cycles(
    controller: Controller,
    plants: Sequence[tuple[float, float]],
    cycles: int = CYCLES,
    torque_limit: float = UNLIMITED,
    shown: Sequence[int] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Runs an adaptive law with the published gains from rest at -pi/3 on all plants (M, mu) at once.

    Returns:
        Whether contact was lost or the pendulum reached the platform, shape (plants,), and the largest of each of
        `ERRORS` at the calls of the law in the cycles `shown`, counted from 1, shape (shown, 3, plants).
    """
    options = {"torque_limit": torque_limit, "physics_dt": min(controller.dt, LAW_DT)}
    # A cycle that is not shown is one step. In others, a step is one call of the law.
    simulation, recorded = (
        make_simulation(controller, plants, control_dt, **options) for control_dt in (PROPOSED.period, controller.dt)
    )
    running, nothing = np.ones(len(plants), np.bool_), np.zeros(len(plants))
    errors = np.zeros((len(shown), len(ERRORS), len(plants)))
    for cycle in range(1, cycles + 1):
        if cycle in shown:
            recorded.world[:] = simulation.world
            errors[shown.index(cycle)] = np.where(running, _record_cycle(recorded, running), 0.0)
            simulation.world[:] = recorded.world
        else:
            simulation.step(nothing, running)
        running &= simulation.row(Row.termination) == 0.0
        if not running.any():
            break
    return ~running, errors


def _record_cycle(simulation: Simulation, running: np.ndarray) -> np.ndarray:
    """The largest of each of `ERRORS` in a cycle, shape (3, plants); a step is one call of the law."""
    active, nothing, steps = running.copy(), np.zeros(len(running)), len(simulation.reference)
    states, clocks = np.empty((steps, 2, len(running))), np.empty((steps, len(running)))
    for n in range(steps):
        simulation.step(nothing, active)
        states[n], clocks[n] = simulation.rows(Row.theta, Row.theta_dot + 1), simulation.row(Row.clock)
        active &= simulation.row(Row.termination) == 0.0
    wanted = simulation.reference[clocks.astype(np.int64), :2]
    error, rate_error = states[:, 0] - wanted[..., 0], states[:, 1] - wanted[..., 1]
    return np.abs([error, rate_error, rate_error + PUBLISHED.Lambda_theta * error]).max(axis=1)


def study_variants() -> list[tuple[float, float, int, int, int, int]]:
    """The unregularised law with other choices, five cycles on every plant of the grid.

    The choices change one at a time from the law's own, then at the corners; at 10 kHz, the slowest runs, with n = 1.

    Returns:
        beta (rad^2/s^2), eta(0), n, rate (Hz), and the number of plants that fail without and with the torque limit.
    """
    own = (UNREGULARISED.beta, UNREGULARISED.eta_0, UNREGULARISED.n, RATES[0])
    ranges: tuple[tuple[Any, ...], ...] = (BETAS, ETAS, EXPONENTS, RATES)
    settings = [own, *((*own[:i], value, *own[i + 1 :]) for i, values in enumerate(ranges) for value in values)]
    corners = itertools.product(*((values[0], values[-1]) for values in ranges))
    settings += [corner for corner in corners if corner[3] == RATES[0] or corner[2] == own[2]]
    variants = []
    for beta, eta_0, n, rate in dict.fromkeys(settings):
        controller = adaptive(regularised=False, beta=beta, eta_0=eta_0, n=n, dt=1.0 / rate)
        failed = [run_cycles(controller, plant_grid(), torque_limit=limit)[0] for limit in (UNLIMITED, TORQUE_LIMIT)]
        variants.append((beta, eta_0, n, rate, int(failed[0].sum()), int(failed[1].sum())))
    return variants


def study_long_runs() -> dict[int, list[dict[int, tuple[float, ...]]]]:
    """The regularised law on the nominal plant and the corners: `LONGEST` cycles at 1 kHz, `LONG` above.

    Returns:
        By rate (Hz), plant and cycle from 1, the largest of each of `ERRORS` in that cycle.
    """
    runs, plants = {}, [NOMINAL_PLANT, *CORNERS]
    for rate in RATES:
        cycles = LONGEST if rate == RATES[0] else LONG
        shown = [n for n in SHOWN_CYCLES if n <= cycles]
        _, errors = run_cycles(adaptive(dt=1.0 / rate), plants, cycles=cycles, shown=shown)
        by_plant = errors.transpose(2, 0, 1).tolist()
        runs[rate] = [dict(zip(shown, map(tuple, own), strict=True)) for own in by_plant]
    return runs


def study_adaptive() -> dict[str, Any]:
    """Runs all studies of the adaptive law, in half a minute.

    Returns:
        `laws`: the `LawStudy` of the regularised law, of the corrected, unregularised one, and of the latter with the
        motor's torque limited. `variants` and `long_runs`: see `study_variants` and `study_long_runs`.
    """
    laws = [study_law(True), study_law(False), study_law(False, TORQUE_LIMIT)]
    return {"laws": laws, "variants": study_variants(), "long_runs": study_long_runs()}


def cycle_errors(study: dict[str, Any], quantity: str, cycle: int, rate: int = RATES[0]) -> list[float]:
    """The largest of one of `ERRORS` in a cycle of the long runs, on the nominal plant and on each corner."""
    return [run[cycle][ERRORS.index(quantity)] for run in study["long_runs"][rate]]
