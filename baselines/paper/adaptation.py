"""What the adaptive law (37) to (39) does inside a recorded run: its terms, its estimates, the Lyapunov function (40).

The law keeps only its memory; everything else is recomputed here from the states and the memory of a `Trace`, for the
whole run at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from baselines.laws.adaptive import (
    BETA,
    BETA_AS_PUBLISHED,
    N_EXPONENT,
    SATURATION_WIDTH,
    eta_of,
    initial_memory,
    nominal_estimates,
)
from baselines.laws.gains import GAMMA_1, GAMMA_2, K_1, K_2, K_3, LAMBDA_THETA, LAMBDA_X
from baselines.paper.traces import Trace
from capsule_gym.parameters import Capsule, Plant

# A change of V below this is rounding.
RESOLUTION = 1e-12


@dataclass(frozen=True)
class Terms:
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
        work: delta_x Y_x alpha^_x, W: the term whose sign decides whether V falls.
    """

    error_x: np.ndarray
    delta_theta: np.ndarray
    delta_x: np.ndarray
    T_c: np.ndarray
    T_n: np.ndarray
    estimates_theta: np.ndarray
    estimates_x: np.ndarray
    eta: np.ndarray
    work: np.ndarray


def law_terms(run: Trace, *, as_published: bool, nominal: Plant | None = None) -> Terms:
    """Recomputes the adaptive law with the published gains along a run.

    Args:
        run: of `adaptive()` or `adaptive_as_published()`.
        as_published: which of the two.
        nominal: the plant that the law starts from.
    """
    p = nominal or Capsule().plant()
    # The memory of a sample is what its call left; the call itself used the one before, but its own anchor.
    before = np.vstack([initial_memory(p, 0.0), run.memory[:-1]])
    h, g, eta = before[:, :5], before[:, 5:9], eta_of(before)
    theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, _ = run.reference.T
    e, e_dot = run.theta - theta_d, run.theta_dot - theta_d_dot
    e_x, e_x_dot = run.x - (run.memory[:, 10] + x_d), run.x_dot - x_d_dot
    rho_theta, rho_theta_dot = theta_d_dot - LAMBDA_THETA * e, theta_d_ddot - LAMBDA_THETA * e_dot  # Eq. (37a)
    rho_x_dot = x_d_ddot - LAMBDA_X * e_x_dot
    delta_theta, delta_x = e_dot + LAMBDA_THETA * e, e_x_dot + LAMBDA_X * e_x  # Eq. (37b)
    sin, cos = np.sin(run.theta), np.cos(run.theta)
    normal = (p.M + p.m) * p.g - p.m * p.l * (theta_d_ddot * sin + run.theta_dot**2 * cos)
    normal -= p.pivot_torque_on_contact * (p.k * run.theta + p.c * run.theta_dot) * sin
    contact = np.maximum(0.0, normal) * np.sign(run.x_dot)
    Y_theta = np.stack([rho_theta_dot, -cos * rho_x_dot, run.theta, run.theta_dot, -sin], axis=1)  # Eq. (38)
    Y_x = np.stack([-cos * rho_theta_dot, rho_x_dot, contact, sin * run.theta_dot * rho_theta], axis=1)
    work = delta_x * (Y_x * g).sum(axis=1)
    T_c = (Y_theta * h).sum(axis=1) - K_1 * delta_theta  # Eq. (39b)
    sgn = np.sign(delta_theta) if as_published else np.clip(delta_theta / SATURATION_WIDTH, -1.0, 1.0)
    share = delta_theta / (delta_theta**2 + (BETA_AS_PUBLISHED if as_published else BETA))
    T_n = -sgn * np.abs(delta_x) * (np.abs(eta) + K_2)
    T_n -= share * ((eta + 1.0) * K_3 * delta_x**2 + (eta - 1.0) * np.abs(work))  # Eq. (39c)
    return Terms(e_x, delta_theta, delta_x, T_c, T_n, h, g, eta, work)


def lyapunov(terms: Terms, theta: np.ndarray, plant: Plant) -> np.ndarray:
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
    n = N_EXPONENT
    auxiliary = (2.0 * n + 1.0) / (2.0 * n) * terms.eta ** (2.0 * n / (2.0 * n + 1.0))
    return kinetic + 0.5 * wrong_theta / GAMMA_1 + 0.5 * wrong_x / GAMMA_2 + auxiliary  # Eq. (40)


def derivative(terms: Terms, beta: float, *, norm: bool = True) -> np.ndarray:
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
    size = np.abs(terms.work)
    auxiliary = size if norm else size - terms.eta * (size - terms.work)
    falling = -K_1 * d**2 - np.abs(d * dx) * (terms.eta + K_2) - share * K_3 * dx**2
    return falling + share * auxiliary - terms.work


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


def descent(run: Trace, plant: Plant, *, as_published: bool) -> Descent:
    """The course of the Lyapunov function along a run of the adaptive law.

    Args:
        run: the run.
        plant: its true plant.
        as_published: which of the two laws ran.
    """
    terms = law_terms(run, as_published=as_published)
    V = lyapunov(terms, run.theta, plant)
    change = np.diff(V)
    rises = np.where(change > RESOLUTION, change, 0.0)
    anchored = run.reference[1:, 6] > 0.0
    stuck = (run.x_dot[:-1] == 0.0) & ~anchored
    slipping = ~anchored & ~stuck
    negative = terms.work[:-1] < 0.0
    causes = {
        "x_d starts anew": anchored,
        "stick: (38) takes f for mu N sign(x')": stuck,
        "slip, delta_x Y_x alpha^_x < 0": slipping & negative,
        "slip, delta_x Y_x alpha^_x >= 0": slipping & ~negative,
    }
    total = float(rises.sum())
    slope = derivative(terms, BETA_AS_PUBLISHED if as_published else BETA)[:-1][slipping]
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
