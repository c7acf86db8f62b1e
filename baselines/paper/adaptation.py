"""What the adaptive law (37) to (39) does inside a recorded run: its terms, its estimates, the Lyapunov function (40).

The law keeps only its memory; everything else is recomputed here from the states and the memory of a `Trace`, for the
whole run at once and by the functions of which the law is made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from baselines.laws.adaptive import constants_of, eta_of, initial_memory, nominal_estimates
from baselines.laws.adaptive_terms import MEMORY, Constants, adaptive_terms
from baselines.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED, Choices
from baselines.laws.profiles import PROPOSED
from baselines.laws.reference import COLUMNS, reference_table
from baselines.paper.traces import Trace
from capsule_gym.compilation import compile_cached
from capsule_gym.layout import load
from capsule_gym.parameters import LAW_DT, NOMINAL, Plant

# A change of V below this is rounding.
RESOLUTION = 1e-12
CELLS, ENTRIES = len(MEMORY), len(COLUMNS)


@dataclass(frozen=True)
class RecordedTerms:
    """The adaptive law's own quantities at every call of a run, shape (n,) where nothing else is said.

    Attributes:
        error_x: x - x_d, m.
        delta_theta: rad/s.
        delta_x: m/s.
        T_c: N m.
        T_n: N m.
        estimates_theta: before the call, shape (n, 5).
        estimates_x: before the call, shape (n, 4).
        eta: before the call.
        power: delta_x Y_x alpha^_x, W: the term whose sign decides whether V falls.
    """

    error_x: np.ndarray
    delta_theta: np.ndarray
    delta_x: np.ndarray
    T_c: np.ndarray
    T_n: np.ndarray
    estimates_theta: np.ndarray
    estimates_x: np.ndarray
    eta: np.ndarray
    power: np.ndarray


def recompute(
    states: np.ndarray, memories: np.ndarray, references: np.ndarray, constants: Constants, found: np.ndarray
) -> None:
    """`adaptive_terms` at every call of a run.

    Args:
        states: theta, theta', x and x' in a row, shape (4 n,).
        memories: likewise, shape (CELLS n,).
        references: likewise, shape (ENTRIES n,).
        constants: of the law.
        found: error_x, delta_theta, delta_x, T_c, T_n and power, shape (n, 6); written.
    """
    for i in range(len(found)):
        theta, theta_dot, x, x_dot = load(states, 4 * i, 1, 4)
        memory, reference = load(memories, CELLS * i, 1, CELLS), load(references, ENTRIES * i, 1, ENTRIES)
        terms = adaptive_terms(theta, theta_dot, x, x_dot, memory, reference, constants)
        found[i, 0], found[i, 1], found[i, 2] = terms.e_x, terms.delta_theta, terms.delta_x
        found[i, 3], found[i, 4], found[i, 5] = terms.T_c, terms.T_n, terms.power


@lru_cache(maxsize=1)
def _recompute() -> Any:
    """The function above, compiled."""
    return compile_cached(recompute)


def form(*, regularised: bool) -> Choices:
    """What `adaptive()` chooses, or `adaptive_as_published()`."""
    return REGULARISED if regularised else UNREGULARISED


def law_terms(run: Trace, *, regularised: bool) -> RecordedTerms:
    """Recomputes the adaptive law with the published gains along a run.

    Args:
        run: of `adaptive()` or `adaptive_as_published()`.
        regularised: which of the two.
    """
    plant, choices = NOMINAL.plant(), form(regularised=regularised)
    constants = constants_of(PUBLISHED, choices, plant, reference_table(PROPOSED, plant), LAW_DT)
    # The memory of a sample is what its call left; the call itself used the one before, but its own anchor.
    before = np.vstack([initial_memory(constants, choices.eta_0), run.memory[:-1]])
    before[:, MEMORY.index("x_anchor")] = run.memory[:, MEMORY.index("x_anchor")]
    states = np.stack([run.theta, run.theta_dot, run.x, run.x_dot], axis=1)
    found = np.empty((len(states), 6))
    _recompute()(states.ravel(), before.ravel(), run.reference.ravel(), constants, found)
    error_x, delta_theta, delta_x, T_c, T_n, power = found.T
    eta = eta_of(before, choices.n)
    return RecordedTerms(error_x, delta_theta, delta_x, T_c, T_n, before[:, :5], before[:, 5:9], eta, power)


def lyapunov(terms: RecordedTerms, theta: np.ndarray, plant: Plant) -> np.ndarray:
    """The Lyapunov function V of Eq. (40) with the true plant's parameters.

    Args:
        terms: the law's quantities along a run.
        theta: rad, at the same samples.
        plant: the true plant.
    """
    alpha = np.array(nominal_estimates(plant))
    ml = plant.m * plant.l
    kinetic = 0.5 * (ml * plant.l * terms.delta_theta**2 + (plant.M + plant.m) * terms.delta_x**2)
    kinetic -= ml * np.cos(theta) * terms.delta_theta * terms.delta_x
    wrong_theta = ((terms.estimates_theta - alpha[:5]) ** 2).sum(axis=1)
    wrong_x = ((terms.estimates_x - alpha[5:]) ** 2).sum(axis=1)
    n = REGULARISED.n
    auxiliary = (2.0 * n + 1.0) / (2.0 * n) * terms.eta ** (2.0 * n / (2.0 * n + 1.0))
    return kinetic + 0.5 * wrong_theta / PUBLISHED.Gamma_1 + 0.5 * wrong_x / PUBLISHED.Gamma_2 + auxiliary  # Eq. (40)


def derivative(terms: RecordedTerms, beta: float, *, norm: bool = True) -> np.ndarray:
    """V' of Eq. (41) before its last two steps, with sgn as printed: what the law makes of (38) while it slips.

    With s = delta_theta^2 / (delta_theta^2 + beta), w = delta_x Y_x alpha^_x and W = |w|, the terms of (39) leave

        V' = -K1 delta_theta^2 - |delta_theta delta_x| (eta + K2) - s K3 delta_x^2 + s W - w

    if (39d) has the norm that (41) uses, and s (W - eta (W - w)) in place of s W as (39d) is printed. The paper drops
    what stands behind the third term as <= 0. That is so for w >= 0. For w < 0 it is (1 + s) W > 0 with the norm, and
    (1 + s - 2 eta s) W as printed: then V can rise.

    Args:
        terms: the law's quantities.
        beta: of (39c).
        norm: whether (39d) has the norm.
    """
    d, dx = terms.delta_theta, terms.delta_x
    share = d**2 / (d**2 + beta)
    size = np.abs(terms.power)
    auxiliary = size if norm else size - terms.eta * (size - terms.power)
    falling = -PUBLISHED.K1 * d**2 - np.abs(d * dx) * (terms.eta + PUBLISHED.K2) - share * PUBLISHED.K3 * dx**2
    return falling + share * auxiliary - terms.power


@dataclass(frozen=True)
class Course:
    """How a number goes along a run.

    Attributes:
        name: what it is.
        true: the plant's own value; None where there is none.
        start: at the first call.
        end: at the last.
        low: the smallest.
        high: the largest.
    """

    name: str
    true: float | None
    start: float
    end: float
    low: float
    high: float

    @property
    def approached(self) -> bool | None:
        """Whether the estimate ends at least a tenth of its initial error closer to the truth; None where it is right.

        It need not: (39e) drives the errors of tracking to zero, and once they are, the estimates stay where they are.
        """
        if self.true is None or math.isclose(self.start, self.true, rel_tol=1e-3):
            return None
        return abs(self.end - self.true) < 0.9 * abs(self.start - self.true)


ESTIMATES = ("m l^2", "m l", "k", "c", "m g l", "m l (x)", "M + m", "mu", "m l (x, centrifugal)")


def courses(run: Trace, plant: Plant) -> list[Course]:
    """The course of the nine estimates and of eta."""
    truth: list[float | None] = [*nominal_estimates(plant), None]
    values_of = [*run.memory[:, : len(ESTIMATES)].T, eta_of(run.memory)]
    return [
        Course(name, true, float(values[0]), float(values[-1]), float(values.min()), float(values.max()))
        for name, true, values in zip((*ESTIMATES, "eta"), truth, values_of, strict=True)
    ]


@dataclass(frozen=True)
class Descent:
    """Whether V of Eq. (40) falls along a run.

    Attributes:
        start: V at the first call.
        end: V at the last.
        highest: the largest V.
        rising: fraction of the time in which it rises.
        rise: sum of all rises.
        fall: sum of all falls, >= 0.
        rise_by_cause: the share of each cause in `rise`, by name.
        positive: fraction of the slipping time in which the right side of (41) as derived is positive.
    """

    start: float
    end: float
    highest: float
    rising: float
    rise: float
    fall: float
    rise_by_cause: dict[str, float]
    positive: float


def descent(run: Trace, plant: Plant, *, regularised: bool) -> Descent:
    """The course of the Lyapunov function along a run of the adaptive law.

    Args:
        run: the run.
        plant: its true plant.
        regularised: which form of the law ran.
    """
    terms = law_terms(run, regularised=regularised)
    V = lyapunov(terms, run.theta, plant)
    change = np.diff(V)
    rises = np.where(change > RESOLUTION, change, 0.0)
    anchored = run.reference[1:, COLUMNS.index("cycle_start")] > 0.0
    stuck = (run.x_dot[:-1] == 0.0) & ~anchored
    slipping = ~anchored & ~stuck
    negative = terms.power[:-1] < 0.0
    causes = {
        "x_d starts anew": anchored,
        "stick: (38) takes f for mu N sign(x')": stuck,
        "slip, delta_x Y_x alpha^_x < 0": slipping & negative,
        "slip, delta_x Y_x alpha^_x >= 0": slipping & ~negative,
    }
    total = float(rises.sum())
    slope = derivative(terms, form(regularised=regularised).beta)[:-1][slipping]
    return Descent(
        start=float(V[0]),
        end=float(V[-1]),
        highest=float(V.max()),
        rising=float((rises > 0.0).mean()),
        rise=total,
        fall=float(np.abs(change[change < 0.0]).sum()),
        rise_by_cause={name: float(rises[where].sum()) / total if total else 0.0 for name, where in causes.items()},
        positive=float((slope > 0.0).mean()) if len(slope) else 0.0,
    )
