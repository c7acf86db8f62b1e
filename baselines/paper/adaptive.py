"""The adaptive law (37) to (39) over the paper's ranges, open choices and long runs, and its
Lyapunov function (40).

Two forms of the law run: regularised (`adaptive`), and corrected without regularisation
(`adaptive_as_published`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.paper.published import M_RANGE, MU_RANGE
from baselines.paper.tracking import CYCLES, UNLIMITED, Trajectory, make_simulation, simulate
from capsule_gym.control.controller import LAW_DT, Controller
from capsule_gym.control.laws.adaptive import (
    MEMORY,
    adaptive,
    eta_of,
    nominal_estimates,
    sliding_variables,
)
from capsule_gym.control.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED
from capsule_gym.control.laws.profiles import PROPOSED
from capsule_gym.core.layout import Row
from capsule_gym.parameters import NOMINAL, Plant

REGULARISED_LAW, CORRECTED_LAW = "regularised", "corrected, unregularised"
# |theta - theta_d| (rad), |theta' - theta_d'| (rad/s) and |delta_theta| (rad/s).
ERRORS = ("angle_error", "rate_error", "sliding")

GRID = 5
# beta, eta(0) and n, which the paper leaves open, and the rate of the law in Hz.
BETAS, ETAS, EXPONENTS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0), (0.1, 0.3, 1.0), (1, 2, 3)
RATES = (1000, 2000, 5000, 10_000)
# The long runs: the nominal plant, then the corners of the ranges, and the cycles that are
# compared.
LONG_PLANTS = [(NOMINAL.M, NOMINAL.mu), *itertools.product(M_RANGE, MU_RANGE)]
LONG_CYCLES = (1, 60, 600)


def sliding(run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """delta_theta (rad/s) and delta_x (m/s) of (37b) over a run of the adaptive law with the
    published gains.
    """
    state, anchors = (
        (run.theta, run.theta_dot, run.x, run.x_dot),
        run.memory[:, MEMORY.index("x_anchor")],
    )
    return sliding_variables(state, anchors, run.reference.T, PUBLISHED)


def lyapunov(run: Trajectory, start: tuple[float, ...], plant: Plant) -> np.ndarray:
    """The Lyapunov function V of Eq. (40) at every call of a run of the adaptive law with the
    published gains.

    `start` is the law's memory before its first call; the parameters of `plant` are the true ones.
    """
    (delta_theta, delta_x), ml, n = sliding(run), plant.m * plant.l, REGULARISED.n
    # The memory of a sample is that after its call; the call itself used the one before.
    before = np.vstack([start, run.memory[:-1]])
    kinetic = 0.5 * (ml * plant.l * delta_theta**2 + (plant.M + plant.m) * delta_x**2)
    kinetic -= ml * np.cos(run.theta) * delta_theta * delta_x
    squares = (before[:, :9] - nominal_estimates(plant)) ** 2
    wrong = (
        squares[:, :5].sum(axis=1) / PUBLISHED.Gamma_1
        + squares[:, 5:].sum(axis=1) / PUBLISHED.Gamma_2
    )
    return (
        kinetic
        + 0.5 * wrong
        + (2.0 * n + 1.0) / (2.0 * n) * eta_of(before) ** (2.0 * n / (2.0 * n + 1.0))
    )


@dataclass(frozen=True)
class LawStudy:
    """One form of the adaptive law, with a torque limit in N m, five cycles on each plant of the
    grid.

    A run has `M` (kg), `mu`, `failed` (whether it ended early), `error_rms` of theta - theta_d
    (rad), `peak_velocity` (rad/s), `peak_torque` (N m), `mean_speed` (cm/s), `eta` at its end, the
    sum of all rises of the Lyapunov function (40) (`rise`) and the fraction of the time in which it
    rises (`rising`).
    """

    law: str
    torque_limit: float
    runs: list[dict[str, Any]]

    @property
    def failures(self) -> int:
        """Number of runs that ended early."""
        return sum(run["failed"] for run in self.runs)

    def worst(self, quantity: str, *, smallest: bool = False) -> dict[str, Any]:
        """The run with the largest, or the smallest, value of one of its numbers."""
        return (min if smallest else max)(self.runs, key=lambda run: run[quantity])


def plant_grid() -> list[tuple[float, float]]:
    """The plants (M, mu) of the adaptive runs: 5 x 5 over the paper's ranges, corners and centre
    included.
    """
    masses, frictions = (np.linspace(*limits, GRID).tolist() for limits in (M_RANGE, MU_RANGE))
    return list(itertools.product(masses, frictions))


def study_law(regularised: bool, torque_limit: float = UNLIMITED) -> LawStudy:
    """Runs one form of the adaptive law over the grid."""
    controller, plants, runs = adaptive(regularised=regularised), plant_grid(), []
    for (M, mu), run in zip(
        plants, simulate(controller, plants, torque_limit=torque_limit), strict=True
    ):
        change = np.diff(lyapunov(run, controller.memory, NOMINAL.plant(M, mu)))
        rises = change[change > 1e-12]  # below is rounding
        values: dict[str, Any] = {
            "M": M,
            "mu": mu,
            "failed": not run.completed,
            "error_rms": run.error_rms,
        }
        values |= {
            "peak_velocity": float(run.theta_dot.max()),
            "peak_torque": run.metrics["peak_torque"],
        }
        speed = 100.0 * run.metrics["distance"] / run.metrics["duration"]
        values |= {"mean_speed": speed, "eta": float(eta_of(run.memory[-1]))}
        runs.append({**values, "rise": float(rises.sum()), "rising": len(rises) / len(change)})
    return LawStudy(REGULARISED_LAW if regularised else CORRECTED_LAW, torque_limit, runs)


def run_cycles(
    controller: Controller,
    plants: Sequence[tuple[float, float]],
    cycles: int = CYCLES,
    shown: Sequence[int] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Runs an adaptive law with the published gains from rest at -pi/3 on all plants (M, mu) at
    once.

    Returns:
        Whether contact was lost or the pendulum reached the platform, shape (plants,), and the
        largest of each of `ERRORS` at the calls of the law in the cycles `shown`, counted from 1,
        shape (shown, 3, plants).
    """
    options = {"torque_limit": UNLIMITED, "physics_dt": min(controller.dt, LAW_DT)}
    # A cycle that is not shown is one step. In others, a step is one call of the law.
    simulation, recorded = (
        make_simulation(controller, plants, control_dt, **options)
        for control_dt in (PROPOSED.period, controller.dt)
    )
    running, nothing = np.ones(len(plants), np.bool_), np.zeros(len(plants))
    errors = np.zeros((len(shown), len(ERRORS), len(plants)))
    for cycle in range(1, cycles + 1):
        own = recorded if cycle in shown else simulation
        own.world[:] = simulation.world
        for _ in range(len(recorded.reference) if own is recorded else 1):
            own.step(nothing, running)
            running &= own.row(Row.termination) == 0.0
            if own is recorded:
                wanted = own.reference[own.row(Row.clock).astype(np.int64), :2].T
                error, rate_error = own.rows(Row.theta, Row.theta_dot + 1) - wanted
                largest = errors[shown.index(cycle)]
                found = np.abs([error, rate_error, rate_error + PUBLISHED.Lambda_theta * error])
                np.maximum(largest, found, out=largest)
        simulation.world[:] = own.world
        if not running.any():
            break
    return ~running, errors


def study_variants() -> list[tuple[float, float, int, int, int]]:
    """The unregularised law with other choices, five cycles on every plant of the grid.

    The choices change one at a time from the law's own, then at the corners; at 10 kHz, the slowest
    runs, with n = 1.

    Returns:
        beta (rad^2/s^2), eta(0), n, rate (Hz), and the number of plants that fail.
    """
    own = (UNREGULARISED.beta, UNREGULARISED.eta_0, UNREGULARISED.n, RATES[0])
    ranges: tuple[tuple[Any, ...], ...] = (BETAS, ETAS, EXPONENTS, RATES)
    settings = [
        own,
        *((*own[:i], value, *own[i + 1 :]) for i, values in enumerate(ranges) for value in values),
    ]
    corners = itertools.product(*((values[0], values[-1]) for values in ranges))
    settings += [corner for corner in corners if corner[3] == RATES[0] or corner[2] == own[2]]
    variants = []
    for beta, eta_0, n, rate in dict.fromkeys(settings):
        controller = adaptive(regularised=False, beta=beta, eta_0=eta_0, n=n, dt=1.0 / rate)
        failed, _ = run_cycles(controller, plant_grid())
        variants.append((beta, eta_0, n, rate, int(failed.sum())))
    return variants
