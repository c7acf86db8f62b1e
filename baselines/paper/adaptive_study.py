"""What the paper's Section 5 says of the adaptive law (39), computed anew: over the ranges, open choices and time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from baselines.laws.adaptive import adaptive, adaptive_as_published, eta_of
from baselines.laws.gains import UNREGULARISED
from baselines.paper.adaptation import Course, Descent, courses, descent, law_terms
from baselines.paper.adaptive_variants import PEAKS, endure, varied
from baselines.paper.published import M_RANGE, MU_RANGE
from baselines.paper.traces import CYCLES, UNLIMITED, Trace, traces
from capsule_gym.parameters import LAW_DT, NOMINAL
from capsule_gym.task import TORQUE_LIMIT

Plants = list[tuple[float, float]]

GRID = 5
REGULARISED_LAW, CORRECTED_LAW = "regularised", "corrected, unregularised"
# What the paper leaves open, and the rate in Hz that it runs at.
BETAS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
ETAS = (0.1, 0.3, 1.0)
EXPONENTS = (1, 2, 3)
RATES = (1000, 2000, 5000, 10_000)
# Of M or of mu, in percent to either side.
DEVIATIONS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
LONG, LONGEST = 60, 600
SHOWN_CYCLES = (1, 5, 10, 20, LONG, 200, LONGEST)


@dataclass(frozen=True)
class AdaptiveRun:
    """Five cycles of the adaptive law (39) on one plant.

    Attributes:
        M: kg.
        mu: friction coefficient.
        until: how far it came, s.
        ending: what ended it early; empty where nothing did.
        error_rms: of theta - theta_d, rad.
        error_max: largest |theta - theta_d|, rad.
        peak_velocity: largest theta', rad/s.
        peak_torque: N m.
        mean_speed: over the time that it ran, cm/s.
        drift: largest |x - x_d|, m.
        auxiliary_torque: largest |T_n|, N m.
        eta: at its end.
        sliding_first: largest |delta_theta| in the first cycle, rad/s.
        sliding_last: in the last whole one, rad/s; None where the run did not last.
    """

    M: float
    mu: float
    until: float
    ending: str
    error_rms: float
    error_max: float
    peak_velocity: float
    peak_torque: float
    mean_speed: float
    drift: float
    auxiliary_torque: float
    eta: float
    sliding_first: float
    sliding_last: float | None


@dataclass(frozen=True)
class LawStudy:
    """One form of the adaptive law over the grid of the paper's ranges.

    Attributes:
        law: `REGULARISED_LAW` or `CORRECTED_LAW`.
        torque_limit: N m.
        runs: one per plant, M the slower index.
    """

    law: str
    torque_limit: float
    runs: tuple[AdaptiveRun, ...]

    @property
    def failures(self) -> int:
        """Number of runs that ended early."""
        return sum(bool(run.ending) for run in self.runs)

    def worst(self, quantity: str, *, smallest: bool = False) -> AdaptiveRun:
        """The run with the largest, or the smallest, value of one of its numbers."""
        return (min if smallest else max)(self.runs, key=lambda run: float(getattr(run, quantity)))


@dataclass(frozen=True)
class Adaptation:
    """The inside of the adaptive law on one plant.

    Attributes:
        law: `REGULARISED_LAW` or `CORRECTED_LAW`.
        M: kg.
        mu: friction coefficient.
        courses: of the estimates and of eta.
        descent: of the Lyapunov function.
    """

    law: str
    M: float
    mu: float
    courses: tuple[Course, ...]
    descent: Descent


def plant_grid() -> Plants:
    """The plants (M, mu) of the adaptive runs: 5 x 5 over the paper's ranges, corners and centre included."""
    masses, frictions = (np.linspace(*limits, GRID).tolist() for limits in (M_RANGE, MU_RANGE))
    return [(M, mu) for M in masses for mu in frictions]


def looked_at() -> Plants:
    """The nominal plant and the corners of the paper's ranges."""
    return [(NOMINAL.M, NOMINAL.mu), *itertools.product(M_RANGE, MU_RANGE)]


def study_law(regularised: bool, torque_limit: float = UNLIMITED) -> tuple[LawStudy, tuple[Adaptation, ...]]:
    """Runs one form of the adaptive law over the grid, and looks inside it at the nominal plant and the corners.

    Args:
        regularised: which form.
        torque_limit: N m.
    """
    law = REGULARISED_LAW if regularised else CORRECTED_LAW
    controller = adaptive() if regularised else adaptive_as_published()
    plants = plant_grid()
    runs, inside = [], []
    # Row by row: a run with its memory takes 10 MB.
    for row in range(0, len(plants), GRID):
        batch = plants[row : row + GRID]
        for (M, mu), run in zip(batch, traces(controller, batch, torque_limit=torque_limit), strict=True):
            runs.append(_adaptive_run(run, M, mu, regularised))
            if any(math.isclose(M, M_1) and math.isclose(mu, mu_1) for M_1, mu_1 in looked_at()):
                plant = NOMINAL.plant(M, mu)
                fall = descent(run, plant, regularised=regularised)
                inside.append(Adaptation(law, M, mu, tuple(courses(run, plant)), fall))
    return LawStudy(law, torque_limit, tuple(runs)), tuple(inside)


def _adaptive_run(run: Trace, M: float, mu: float, regularised: bool) -> AdaptiveRun:
    """The numbers of one run."""
    terms = law_terms(run, regularised=regularised)
    sliding = np.abs(terms.delta_theta)
    cycle = round((len(run.t) - 1) / CYCLES) if run.completed else len(run.t)
    ending = ""
    if not run.completed:
        ending = "pendulum at the platform" if abs(run.theta[-1]) >= 0.5 * math.pi else "contact lost"
    return AdaptiveRun(
        M,
        mu,
        until=float(run.t[-1]),
        ending=ending,
        error_rms=run.error_rms,
        error_max=float(np.abs(run.error).max()),
        peak_velocity=float(run.theta_dot.max()),
        peak_torque=run.metrics["peak_torque"],
        mean_speed=100.0 * run.metrics["distance"] / run.metrics["duration"],
        drift=float(np.abs(terms.error_x).max()),
        auxiliary_torque=float(np.abs(terms.T_n).max()),
        eta=float(eta_of(run.memory[-1])),
        sliding_first=float(sliding[:cycle].max()),
        sliding_last=float(sliding[-cycle:].max()) if run.completed else None,
    )


@dataclass(frozen=True)
class Variant:
    """The corrected, unregularised law with other choices, five cycles on every plant of the grid.

    Attributes:
        beta: rad^2/s^2.
        eta_0: eta at the start.
        n: of the exponent in (39d).
        rate: of the law, Hz.
        failures: plants of the grid that fail.
        failures_limited: likewise with the motor limited to `TORQUE_LIMIT`.
    """

    beta: float
    eta_0: float
    n: int
    rate: int
    failures: int
    failures_limited: int


def variant_settings() -> list[tuple[float, float, int, int]]:
    """beta, eta(0), n and the rate: one at a time from the law's own, then the corners.

    The corners at 10 kHz, which cost most, keep the law's own n: it has the least to say.
    """
    own = (UNREGULARISED.beta, UNREGULARISED.eta_0, UNREGULARISED.n, round(1.0 / LAW_DT))
    ranges: tuple[tuple[float, ...], ...] = (BETAS, ETAS, EXPONENTS, RATES)
    singles = [(*own[:i], value, *own[i + 1 :]) for i, values in enumerate(ranges) for value in values]
    corners = [
        corner
        for corner in itertools.product(*((values[0], values[-1]) for values in ranges))
        if corner[3] == RATES[0] or corner[2] == own[2]
    ]
    settings = dict.fromkeys([own, *singles, *corners])
    return [(float(beta), float(eta_0), int(n), int(rate)) for beta, eta_0, n, rate in settings]


def study_variants() -> tuple[Variant, ...]:
    """The failures with every one of `variant_settings`."""
    plants = plant_grid()
    variants = []
    for beta, eta_0, n, rate in variant_settings():
        controller = varied(regularised=False, beta=beta, eta_0=eta_0, n=n, dt=1.0 / rate)
        free, limited = (endure(controller, plants, torque_limit=limit) for limit in (UNLIMITED, TORQUE_LIMIT))
        variants.append(Variant(beta, eta_0, n, rate, free.failures, limited.failures))
    return tuple(variants)


@dataclass(frozen=True)
class Deviation:
    """The corrected, unregularised law on a plant that is off the nominal one in one parameter.

    Attributes:
        parameter: "M" or "mu".
        percent: by how much, signed.
        until: when it fails, s; None where it lasts `LONG` cycles.
    """

    parameter: str
    percent: float
    until: float | None


def study_deviations() -> tuple[Deviation, ...]:
    """How long the law lasts on plants that deviate by `DEVIATIONS`."""
    off = [sign * percent for percent in DEVIATIONS for sign in (-1.0, 1.0)]
    plants = [(NOMINAL.M * (1.0 + 0.01 * percent), NOMINAL.mu) for percent in off]
    plants += [(NOMINAL.M, NOMINAL.mu * (1.0 + 0.01 * percent)) for percent in off]
    found = endure(varied(regularised=False), plants, cycles=LONG)
    names = itertools.product(("M", "mu"), off)
    return tuple(
        Deviation(parameter, percent, float(until) if failed else None)
        for (parameter, percent), until, failed in zip(names, found.until, found.failed, strict=True)
    )


@dataclass(frozen=True)
class LongRun:
    """The largest errors of some cycles in a long run of the regularised law on one plant.

    Attributes:
        M: kg.
        mu: friction coefficient.
        rate: of the law, Hz.
        cycles: which, from 1.
        angle_error: largest |theta - theta_d| of each, rad.
        rate_error: largest |theta' - theta_d'|, rad/s.
        sliding: largest |delta_theta|, rad/s.
    """

    M: float
    mu: float
    rate: int
    cycles: tuple[int, ...]
    angle_error: tuple[float, ...]
    rate_error: tuple[float, ...]
    sliding: tuple[float, ...]

    def at(self, quantity: str, cycle: int) -> float:
        """One of the errors in a cycle."""
        return float(getattr(self, quantity)[self.cycles.index(cycle)])


def study_long_runs() -> tuple[LongRun, ...]:
    """`LONGEST` cycles at the law's own rate, `LONG` at the others, on the nominal plant and the corners."""
    plants = looked_at()
    runs = []
    for rate in RATES:
        count = LONGEST if rate == RATES[0] else LONG
        shown = tuple(cycle for cycle in SHOWN_CYCLES if cycle <= count)
        found = endure(varied(regularised=True, dt=1.0 / rate), plants, cycles=count)
        for i, (M, mu) in enumerate(plants):
            errors = (tuple(float(found.peaks[cycle - 1, k, i]) for cycle in shown) for k in range(len(PEAKS)))
            runs.append(LongRun(M, mu, rate, shown, *errors))
    return tuple(runs)


@dataclass(frozen=True)
class AdaptiveStudy:
    """Everything that is computed of the adaptive law.

    Attributes:
        laws: over the grid: regularised; corrected, unregularised; the latter with the motor's torque limited.
        inside: estimates, eta and Lyapunov function of the first two at the nominal plant and the corners.
        variants: what the unregularised law makes of other choices.
        deviations: how far from the nominal plant it lasts how long.
        long_runs: of the regularised law.
    """

    laws: tuple[LawStudy, ...]
    inside: tuple[Adaptation, ...]
    variants: tuple[Variant, ...]
    deviations: tuple[Deviation, ...]
    long_runs: tuple[LongRun, ...]

    def adaptation(self, law: str, M: float, mu: float) -> Adaptation:
        """What was looked at inside a law on one plant."""
        return next(a for a in self.inside if a.law == law and math.isclose(a.M, M) and math.isclose(a.mu, mu))

    def off_nominal(self, rate: int = RATES[0]) -> list[LongRun]:
        """The long runs of the corners at a rate."""
        return [run for run in self.long_runs if run.rate == rate and run.M != NOMINAL.M]

    def on_nominal(self, rate: int = RATES[0]) -> LongRun:
        """The long run of the nominal plant at a rate."""
        return next(run for run in self.long_runs if run.rate == rate and run.M == NOMINAL.M)


def study_adaptive(progress: Callable[[str], None] | None = None) -> AdaptiveStudy:
    """Runs everything; half a minute.

    Args:
        progress: is told what begins.
    """
    tell = progress or (lambda name: None)
    tell("the regularised adaptive law")
    regularised, inside = study_law(regularised=True)
    tell("the adaptive law, corrected, unregularised")
    corrected, inside_corrected = study_law(regularised=False)
    limited, _ = study_law(regularised=False, torque_limit=TORQUE_LIMIT)
    tell("what the adaptive law leaves open")
    variants, deviations = study_variants(), study_deviations()
    tell("long runs of the adaptive law")
    return AdaptiveStudy(
        (regularised, corrected, limited),
        inside + inside_corrected,
        variants,
        deviations,
        study_long_runs(),
    )
