"""The adaptive law (37) to (39): the paper's ranges, open choices, long runs; V of Eq. (40).

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
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import NOMINAL, Plant

REGULARISED_LAW, CORRECTED_LAW = "regularised", "corrected, unregularised"
# |theta - theta_d| (rad), |theta' - theta_d'| (rad/s) and |delta_theta| (rad/s).
ERRORS = ("angle_error", "rate_error", "sliding")

GRID = 5
ALPHA_THETA_SIZE = 5  # number of its entries, the first estimates in the memory
# beta, eta(0) and n, which the paper leaves open, and the rate of the law in Hz.
BETAS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
ETAS = (0.1, 0.3, 1.0)
EXPONENTS = (1, 2, 3)
RATES = (1000, 2000, 5000, 10_000)
MIN_RISE = 1e-12  # smaller changes of the Lyapunov function are rounding
# The long runs: the nominal plant, then the corners of the ranges, and the cycles that are
# compared.
LONG_PLANTS = [(NOMINAL.M, NOMINAL.mu), *itertools.product(M_RANGE, MU_RANGE)]
LONG_CYCLES = (1, 60, 600)


def sliding(run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """delta_theta (rad/s) and delta_x (m/s) of (37b) over a run with the published gains."""
    state = run.theta, run.theta_dot, run.x, run.x_dot
    anchors = run.memory[:, MEMORY.index("x_anchor")]
    return sliding_variables(state, anchors, run.reference.T, PUBLISHED)


def lyapunov(run: Trajectory, start: tuple[float, ...], plant: Plant) -> np.ndarray:
    """The Lyapunov function V of Eq. (40) at every call of the law, with the published gains.

    `start` is the law's memory before its first call; the parameters of `plant` are the true ones.
    """
    delta_theta, delta_x = sliding(run)
    ml = plant.m * plant.l
    n = REGULARISED.n
    # The memory of a sample is that after its call; the call itself used the one before.
    before = np.vstack([start, run.memory[:-1]])
    rotation = ml * plant.l * delta_theta**2
    translation = (plant.M + plant.m) * delta_x**2
    coupling = ml * np.cos(run.theta) * delta_theta * delta_x
    kinetic = 0.5 * (rotation + translation) - coupling

    parameters = nominal_estimates(plant)
    squares = (before[:, : len(parameters)] - parameters) ** 2
    alpha_theta = squares[:, :ALPHA_THETA_SIZE].sum(axis=1) / PUBLISHED.Gamma_1
    alpha_x = squares[:, ALPHA_THETA_SIZE:].sum(axis=1) / PUBLISHED.Gamma_2
    scale = (2.0 * n + 1.0) / (2.0 * n)
    exponent = 2.0 * n / (2.0 * n + 1.0)
    auxiliary = scale * eta_of(before) ** exponent
    return kinetic + 0.5 * (alpha_theta + alpha_x) + auxiliary


@dataclass(frozen=True)
class LawStudy:
    """Five cycles of one form of the adaptive law on each plant of the grid.

    The torque limit is in N m. A run has `M` (kg), `mu`, `failed` (whether it ended early),
    `error_rms` of theta - theta_d (rad), `peak_velocity` (rad/s), `peak_torque` (N m), `mean_speed`
    (cm/s), `eta` at its end, the sum of all rises of the Lyapunov function (40) (`rise`) and the
    fraction of the time in which it rises (`rising`).
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
        choose = min if smallest else max
        return choose(self.runs, key=lambda run: run[quantity])


def plant_grid() -> list[tuple[float, float]]:
    """5 x 5 plants (M, mu) over the paper's ranges, corners and centre included."""
    masses = np.linspace(*M_RANGE, GRID).tolist()
    frictions = np.linspace(*MU_RANGE, GRID).tolist()
    return list(itertools.product(masses, frictions))


def study_law(regularised: bool, torque_limit: float = UNLIMITED) -> LawStudy:
    """Runs one form of the adaptive law over the grid."""
    controller = adaptive(regularised=regularised)
    plants = plant_grid()
    trajectories = simulate(controller, plants, torque_limit=torque_limit)
    runs = []
    for (M, mu), trajectory in zip(plants, trajectories, strict=True):
        V = lyapunov(trajectory, controller.memory, NOMINAL.plant(M, mu))
        change = np.diff(V)
        rises = change[change > MIN_RISE]
        metrics = trajectory.metrics
        run: dict[str, Any] = {"M": M, "mu": mu, "failed": not trajectory.completed}
        run["error_rms"] = trajectory.error_rms
        run["peak_velocity"] = float(trajectory.theta_dot.max())
        run["peak_torque"] = metrics["peak_torque"]
        run["mean_speed"] = 100.0 * metrics["distance"] / metrics["duration"]
        run["eta"] = float(eta_of(trajectory.memory[-1]))
        run["rise"] = float(rises.sum())
        run["rising"] = len(rises) / len(change)
        runs.append(run)
    law = REGULARISED_LAW if regularised else CORRECTED_LAW
    return LawStudy(law, torque_limit, runs)


def run_cycles(
    controller: Controller,
    plants: Sequence[tuple[float, float]],
    cycles: int = CYCLES,
    shown: Sequence[int] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Runs an adaptive law with the published gains from rest at -pi/3 on plants (M, mu).

    Returns:
        Whether contact was lost or the pendulum reached the platform, shape (plants,), and the
        largest of each of `ERRORS` at the calls of the law in the cycles `shown`, counted from 1,
        shape (shown, 3, plants).
    """
    options = {"torque_limit": UNLIMITED, "physics_dt": min(controller.dt, LAW_DT)}
    # One step is a cycle, or a call of the law in a cycle that is shown.
    by_cycle = make_simulation(controller, plants, PROPOSED.period, **options)
    by_call = make_simulation(controller, plants, controller.dt, **options)
    no_residual = np.zeros(len(plants))
    running = np.ones(len(plants), np.bool_)
    errors = np.zeros((len(shown), len(ERRORS), len(plants)))
    for cycle in range(1, cycles + 1):
        if cycle in shown:
            by_call.world[:] = by_cycle.world
            largest = errors[shown.index(cycle)]
            for _ in range(len(by_call.reference)):
                by_call.step(no_residual, running)
                running &= by_call.row(Row.termination) == 0.0
                np.maximum(largest, np.abs(_tracking_errors(by_call)), out=largest)
            by_cycle.world[:] = by_call.world
        else:
            by_cycle.step(no_residual, running)
            running &= by_cycle.row(Row.termination) == 0.0
        if not running.any():
            break
    return ~running, errors


def _tracking_errors(simulation: Simulation) -> list[np.ndarray]:
    """The current values of `ERRORS`, with their signs."""
    clock = simulation.row(Row.clock).astype(np.int64)
    reference = simulation.reference[clock, :2].T
    error, rate_error = simulation.rows(Row.theta, Row.theta_dot + 1) - reference
    return [error, rate_error, rate_error + PUBLISHED.Lambda_theta * error]


def study_variants() -> list[tuple[float, float, int, int, int]]:
    """The unregularised law with other choices, five cycles on every plant of the grid.

    The choices change one at a time from the law's own, then at the corners; at 10 kHz, the slowest
    runs, with n = 1.

    Returns:
        beta (rad^2/s^2), eta(0), n, rate (Hz), and the number of plants that fail.
    """
    own = (UNREGULARISED.beta, UNREGULARISED.eta_0, UNREGULARISED.n, RATES[0])
    ranges: tuple[tuple[Any, ...], ...] = (BETAS, ETAS, EXPONENTS, RATES)
    choices = [own]
    for i, values in enumerate(ranges):
        choices += [(*own[:i], value, *own[i + 1 :]) for value in values]
    for corner in itertools.product(*((values[0], values[-1]) for values in ranges)):
        _, _, n, rate = corner
        if rate == RATES[0] or n == UNREGULARISED.n:
            choices.append(corner)
    variants = []
    for beta, eta_0, n, rate in dict.fromkeys(choices):
        controller = adaptive(regularised=False, beta=beta, eta_0=eta_0, n=n, dt=1.0 / rate)
        failed, _ = run_cycles(controller, plant_grid())
        failures = int(failed.sum())
        variants.append((beta, eta_0, n, rate, failures))
    return variants
