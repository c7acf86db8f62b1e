"""The adaptive law (37) to (39) over the paper's ranges, open choices and long runs, and its Lyapunov function (40).

Two forms of the law run: regularised (`adaptive`), and corrected without regularisation (`adaptive_as_published`). A
law's constants are constants of the compiler, and other values need another kernel. `varied` therefore keeps them in
additional memory cells; with the choices of `adaptive()` it gives the same torque bit for bit.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from baselines.laws.adaptive import (
    adaptive,
    adaptive_as_published,
    chosen,
    constants_of,
    eta_of,
    initial_memory,
    nominal_estimates,
    root_of_eta,
)
from baselines.laws.adaptive_terms import MEMORY, Constants, adaptive_step, adaptive_terms
from baselines.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED
from baselines.laws.profiles import PROPOSED
from baselines.laws.reference import COLUMNS, reference_table
from baselines.paper.published import M_RANGE, MU_RANGE
from baselines.paper.tracking import CYCLES, UNLIMITED, Trajectory, make_simulation, simulate
from capsule_gym.compilation import compile_cached
from capsule_gym.controller import Controller, Law
from capsule_gym.layout import ROWS, Row, load
from capsule_gym.parameters import LAW_DT, NOMINAL, Plant
from capsule_gym.task import TORQUE_LIMIT

REGULARISED_LAW, CORRECTED_LAW = "regularised", "corrected, unregularised"
CELLS, ENTRIES = len(MEMORY), len(COLUMNS)
# The additional cells of `varied`: its choices, then the largest |theta - theta_d| (rad), |theta' - theta_d'| (rad/s)
# and |delta_theta| (rad/s) since they were last set to zero.
CHOICES = ("beta", "n", "root_bound", "dt", "regularised")
ERRORS = ("angle_error", "rate_error", "sliding")
FIRST_ERROR = CELLS + len(CHOICES)

GRID = 5
NOMINAL_PLANT = (NOMINAL.M, NOMINAL.mu)
CORNERS = list(itertools.product(M_RANGE, MU_RANGE))
# beta, eta(0) and n, which the paper leaves open, and the rate of the law in Hz.
BETAS, ETAS, EXPONENTS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0), (0.1, 0.3, 1.0), (1, 2, 3)
RATES = (1000, 2000, 5000, 10_000)
LONG, LONGEST = 60, 600
SHOWN_CYCLES = (1, 5, 10, 20, LONG, 200, LONGEST)


class LawTerms(NamedTuple):
    """The law's own quantities at every call of a run, shape (n,) except for the estimates.

    Attributes:
        error_x: x - x_d, m.
        delta_theta: rad/s.
        delta_x: m/s.
        T_c: N m.
        T_n: N m.
        estimates: of alpha_theta and alpha_x before the call, shape (n, 9).
        eta: before the call.
    """

    error_x: np.ndarray
    delta_theta: np.ndarray
    delta_x: np.ndarray
    T_c: np.ndarray
    T_n: np.ndarray
    estimates: np.ndarray
    eta: np.ndarray


def recompute(
    states: np.ndarray, memories: np.ndarray, references: np.ndarray, constants: Constants, found: np.ndarray
) -> None:
    """`adaptive_terms` at every call of a run.

    Args:
        states: theta, theta', x and x' in a row, shape (4 n,).
        memories: the law's memories in a row, shape (CELLS n,).
        references: rows of the reference table in a row, shape (ENTRIES n,).
        constants: of the law.
        found: the first five fields of `LawTerms`, shape (n, 5); written.
    """
    for i in range(len(found)):
        theta, theta_dot, x, x_dot = load(states, 4 * i, 1, 4)
        memory, reference = load(memories, CELLS * i, 1, CELLS), load(references, ENTRIES * i, 1, ENTRIES)
        terms = adaptive_terms(theta, theta_dot, x, x_dot, memory, reference, constants)
        found[i, 0], found[i, 1], found[i, 2] = terms.e_x, terms.delta_theta, terms.delta_x
        found[i, 3], found[i, 4] = terms.T_c, terms.T_n


@lru_cache(maxsize=1)
def _recompute() -> Any:
    """The function above, compiled."""
    return compile_cached(recompute)


@lru_cache(maxsize=2)
def _constants(regularised: bool) -> Constants:
    """The constants of a form of the law."""
    plant, choices = NOMINAL.plant(), REGULARISED if regularised else UNREGULARISED
    return constants_of(PUBLISHED, choices, plant, reference_table(PROPOSED, plant), LAW_DT)


def law_terms(run: Trajectory, *, regularised: bool) -> LawTerms:
    """Recomputes the adaptive law with the published gains along a run of the given form."""
    constants = _constants(regularised)
    # The memory of a sample is that after its call; the call itself used the one before, but its own anchor.
    before = np.vstack([initial_memory(constants, REGULARISED.eta_0), run.memory[:-1]])
    before[:, MEMORY.index("x_anchor")] = run.memory[:, MEMORY.index("x_anchor")]
    states = np.stack([run.theta, run.theta_dot, run.x, run.x_dot], axis=1)
    found = np.empty((len(states), 5))
    _recompute()(states.ravel(), before.ravel(), run.reference.ravel(), constants, found)
    error_x, delta_theta, delta_x, T_c, T_n = found.T
    return LawTerms(error_x, delta_theta, delta_x, T_c, T_n, before[:, :9], eta_of(before))


def lyapunov(terms: LawTerms, theta: np.ndarray, plant: Plant) -> np.ndarray:
    """The Lyapunov function V of Eq. (40) with the true plant's parameters, at angles theta (rad)."""
    ml, n = plant.m * plant.l, REGULARISED.n
    kinetic = 0.5 * (ml * plant.l * terms.delta_theta**2 + (plant.M + plant.m) * terms.delta_x**2)
    kinetic -= ml * np.cos(theta) * terms.delta_theta * terms.delta_x
    squares = (terms.estimates - nominal_estimates(plant)) ** 2
    wrong = squares[:, :5].sum(axis=1) / PUBLISHED.Gamma_1 + squares[:, 5:].sum(axis=1) / PUBLISHED.Gamma_2
    return kinetic + 0.5 * wrong + (2.0 * n + 1.0) / (2.0 * n) * terms.eta ** (2.0 * n / (2.0 * n + 1.0))  # Eq. (40)


def evaluate_lyapunov(run: Trajectory, M: float, mu: float, *, regularised: bool) -> dict[str, float]:
    """Whether the Lyapunov function (40) falls along a run on a plant.

    Returns:
        V at the first and last call (`start`, `end`), the fraction of the time in which it rises (`rising`), and the
        sums of all rises and falls (`rise`, `fall`).
    """
    V = lyapunov(law_terms(run, regularised=regularised), run.theta, NOMINAL.plant(M, mu))
    change = np.diff(V)
    rises = np.where(change > 1e-12, change, 0.0)  # below is rounding
    values = {"M": M, "mu": mu, "start": V[0], "end": V[-1], "rising": (rises > 0.0).mean(), "rise": rises.sum()}
    values["fall"] = np.abs(change[change < 0.0]).sum()
    return {name: float(value) for name, value in values.items()}


@dataclass(frozen=True)
class LawStudy:
    """One form of the adaptive law, five cycles on each plant of the grid.

    Attributes:
        law: `REGULARISED_LAW` or `CORRECTED_LAW`.
        torque_limit: N m.
        runs: one per plant, M the slower index: `M` (kg), `mu`, `until` (duration, s), `failed` (whether it ended
            early), `error_rms` of theta - theta_d (rad), `peak_velocity` (rad/s),
            `peak_torque` (N m), `mean_speed` (cm/s), `drift` (largest |x - x_d|, m), `auxiliary_torque` (largest
            |T_n|, N m), and `eta` at its end.
        lyapunov: see `evaluate_lyapunov`, on the nominal plant and the corners of the ranges.
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
    controller = adaptive() if regularised else adaptive_as_published()
    plants, runs, falls = plant_grid(), [], []
    # Row by row: a run with its memory takes 10 MB.
    for row in range(0, len(plants), GRID):
        batch = plants[row : row + GRID]
        for (M, mu), run in zip(batch, simulate(controller, batch, torque_limit=torque_limit), strict=True):
            terms = law_terms(run, regularised=regularised)
            runs.append(
                {
                    "M": M,
                    "mu": mu,
                    "until": float(run.t[-1]),
                    "failed": not run.completed,
                    "error_rms": run.error_rms,
                    "peak_velocity": float(run.theta_dot.max()),
                    "peak_torque": run.metrics["peak_torque"],
                    "mean_speed": 100.0 * run.metrics["distance"] / run.metrics["duration"],
                    "drift": float(np.abs(terms.error_x).max()),
                    "auxiliary_torque": float(np.abs(terms.T_n).max()),
                    "eta": float(eta_of(run.memory[-1])),
                }
            )
            if any(np.allclose((M, mu), plant, rtol=1e-9) for plant in (NOMINAL_PLANT, *CORNERS)):
                falls.append(evaluate_lyapunov(run, M, mu, regularised=regularised))
    return LawStudy(REGULARISED_LAW if regularised else CORRECTED_LAW, torque_limit, runs, falls)


def varied_law(regularised: Constants, unregularised: Constants) -> Law:
    """The law (39) that reads `CHOICES` from its memory and the other constants from the form's own."""

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        beta, n, root_bound, dt, form = memory[CELLS:FIRST_ERROR]
        f = regularised if form > 0.0 else unregularised
        bounds = (root_bound, f.lowest, f.highest, f.anchored, f.cycle_advance)
        constants = Constants(f.plant, f.gains, beta, int(n), f.saturation_width, *bounds, dt)
        torque, kept = adaptive_step(theta, theta_dot, x, x_dot, memory[:CELLS], reference, constants)
        e, e_dot = theta - reference[0], theta_dot - reference[1]
        angle, rate, sliding = memory[FIRST_ERROR:]
        sliding = max(sliding, abs(e_dot + f.gains.Lambda_theta * e))
        return torque, (*kept, beta, n, root_bound, dt, form, max(angle, abs(e)), max(rate, abs(e_dot)), sliding)

    return law


@lru_cache(maxsize=1)
def _varied_law() -> Law:
    """The law above with the constants of both forms."""
    return varied_law(_constants(True), _constants(False))


def varied(
    *,
    regularised: bool,
    beta: float | None = None,
    n: int | None = None,
    eta_0: float | None = None,
    dt: float = LAW_DT,
) -> Controller:
    """The adaptive law with other choices; the arguments, and the torque, are those of `adaptive`."""
    choices = chosen(REGULARISED if regularised else UNREGULARISED, beta, n, eta_0)
    memory = initial_memory(_constants(regularised)._replace(n=choices.n), choices.eta_0)
    bound = root_of_eta(choices.eta_bound, choices.n)
    memory = (*memory, choices.beta, float(choices.n), bound, dt, float(regularised), 0.0, 0.0, 0.0)
    table = reference_table(PROPOSED, NOMINAL.plant(), dt)
    return Controller("adaptive, with its choices in its memory", _varied_law(), table, memory, dt)


@dataclass(frozen=True)
class CycleErrors:
    """How long a controller runs on some plants, and its largest errors in each cycle.

    Attributes:
        until: duration of the run, s, shape (plants,).
        failed: whether contact was lost or the pendulum reached the platform, shape (plants,).
        errors: the largest of each of `ERRORS` in every cycle, shape (cycles, 3, plants).
    """

    until: np.ndarray
    failed: np.ndarray
    errors: np.ndarray


def run_cycles(
    controller: Controller,
    plants: Sequence[tuple[float, float]],
    *,
    cycles: int = CYCLES,
    torque_limit: float = UNLIMITED,
) -> CycleErrors:
    """Runs a controller of `varied` from rest at -pi/3 on all plants (M, mu) at once, with one step per cycle."""
    options = {"torque_limit": torque_limit, "physics_dt": min(controller.dt, LAW_DT)}
    simulation = make_simulation(controller, plants, PROPOSED.period, **options)
    running, nothing = np.ones(len(plants), np.bool_), np.zeros(len(plants))
    first, last = ROWS + FIRST_ERROR, ROWS + FIRST_ERROR + len(ERRORS)
    errors = np.zeros((cycles, len(ERRORS), len(plants)))
    for cycle in range(cycles):
        simulation.step(nothing, running)
        errors[cycle] = np.where(running, simulation.rows(first, last), 0.0)
        for row in range(first, last):
            simulation.write(row, nothing)
        running &= simulation.row(Row.termination) == 0.0
        if not running.any():
            break
    return CycleErrors(simulation.row(Row.duration), ~running, errors)


def study_variants() -> list[tuple[float, float, int, int, int, int]]:
    """The unregularised law with other choices, five cycles on every plant of the grid.

    The choices change one at a time from the law's own, then at the corners; at 10 kHz, which costs most, with n = 1.

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
        controller = varied(regularised=False, beta=beta, eta_0=eta_0, n=n, dt=1.0 / rate)
        found = [run_cycles(controller, plant_grid(), torque_limit=limit) for limit in (UNLIMITED, TORQUE_LIMIT)]
        variants.append((beta, eta_0, n, rate, int(found[0].failed.sum()), int(found[1].failed.sum())))
    return variants


LongRun = dict[int, tuple[float, ...]]  # the largest of each of `ERRORS`, by cycle from 1


def study_long_runs() -> dict[int, list[LongRun]]:
    """The regularised law on the nominal plant and the corners, by rate: `LONGEST` cycles at 1 kHz, `LONG` above."""
    runs = {}
    for rate in RATES:
        cycles = LONGEST if rate == RATES[0] else LONG
        found = run_cycles(varied(regularised=True, dt=1.0 / rate), [NOMINAL_PLANT, *CORNERS], cycles=cycles)
        shown = [n for n in SHOWN_CYCLES if n <= cycles]
        plants = range(1 + len(CORNERS))
        runs[rate] = [{n: tuple(found.errors[n - 1, :, i].tolist()) for n in shown} for i in plants]
    return runs


@dataclass(frozen=True)
class AdaptiveStudy:
    """Everything that is computed of the adaptive law.

    Attributes:
        laws: over the grid: regularised; corrected, unregularised; the latter with the motor's torque limited.
        variants: see `study_variants`.
        long_runs: see `study_long_runs`.
    """

    laws: list[LawStudy]
    variants: list[tuple[float, float, int, int, int, int]]
    long_runs: dict[int, list[LongRun]]

    def errors(self, quantity: str, cycle: int, rate: int = RATES[0]) -> list[float]:
        """The largest of one of `ERRORS` in a cycle of the long runs, on the nominal plant and on each corner."""
        return [run[cycle][ERRORS.index(quantity)] for run in self.long_runs[rate]]


def study_adaptive() -> AdaptiveStudy:
    """Runs everything; half a minute."""
    laws = [study_law(True), study_law(False), study_law(False, TORQUE_LIMIT)]
    return AdaptiveStudy(laws, study_variants(), study_long_runs())
