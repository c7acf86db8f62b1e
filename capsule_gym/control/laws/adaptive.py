"""The paper's adaptive variable-structure law (37) to (39) as a `Controller`: regularised, or
corrected only.
"""

import math
from collections.abc import Sequence
from decimal import Context, Decimal
from typing import Any

import numpy as np

from capsule_gym.checks import check_count, check_number
from capsule_gym.control.controller import LAW_DT, Controller, CoreLaw
from capsule_gym.control.laws.gains import (
    PUBLISHED,
    REGULARISED,
    UNREGULARISED,
    Choices,
    Gains,
    check_gains,
    plant_constants,
)
from capsule_gym.control.laws.profiles import COLUMNS, PROPOSED, Profile, optimal, reference_table
from capsule_gym.parameters import NOMINAL, Capsule, Plant

# The memory: the estimates of alpha_theta and alpha_x, the (2n + 1)-th root of eta, and the start
# of x_d, m.
ESTIMATES = (*(f"alpha_theta_{i}" for i in range(1, 6)), *(f"alpha_x_{i}" for i in range(1, 5)))
MEMORY = (*ESTIMATES, "eta_root", "x_anchor")


def nominal_estimates(p: Plant) -> tuple[float, ...]:
    """alpha_theta = [m l^2, m l, k, c, m g l] and alpha_x = [m l, M + m, mu, m l] of a plant."""
    ml = p.m * p.l
    return ml * p.l, ml, p.k, p.c, ml * p.g, ml, p.M + p.m, p.mu, ml


def constants_of(
    gains: Gains, choices: Choices, plant: Plant, table: np.ndarray, dt: float
) -> dict[str, Any]:
    """The constants of the law by the names that the core gives them; `table` is from
    `reference_table`.
    """
    free = math.isinf(choices.estimate_range)
    low, high = 1.0 - choices.estimate_range, 1.0 + choices.estimate_range
    estimates = nominal_estimates(plant)
    return {
        **plant_constants(plant),
        **gains._asdict(),
        "beta": choices.beta,
        "n": choices.n,
        "saturation_width": choices.saturation_width,
        "root_bound": root_of_eta(choices.eta_bound, choices.n),
        # Not a product if the range is infinite: zero times infinity is NaN.
        "lowest": [-math.inf if free else low * estimate for estimate in estimates],
        "highest": [math.inf if free else high * estimate for estimate in estimates],
        "anchored": choices.anchored,
        # The last row is one step before the end of the cycle; the platform rests there, so x_d is
        # the same.
        "cycle_advance": float(table[-1, COLUMNS.index("x_d")]),
        "dt": dt,
    }


def root_of_eta(eta: float, n: int) -> float:
    """The (2n + 1)-th root of the auxiliary variable, which the memory holds.

    The root is computed in decimal arithmetic: the last digit of a float's power depends on the C
    library.
    """
    exact = Context(prec=40)
    return float(exact.power(Decimal(eta), exact.divide(Decimal(1), Decimal(2 * n + 1))))


def eta_of(memory: np.ndarray, n: int = REGULARISED.n) -> np.ndarray:
    """The auxiliary variable eta from memories of the adaptive law, shape (.., cells)."""
    root = memory[..., MEMORY.index("eta_root")]
    return math.prod([root * root] * n, start=root)


def sliding_variables(
    state: Sequence[np.ndarray], anchor: np.ndarray, reference: np.ndarray, gains: Gains
) -> tuple[np.ndarray, np.ndarray]:
    """delta_theta (rad/s) and delta_x (m/s) of (37b); x_d starts from `anchor`, m; `reference` is
    by `COLUMNS`.
    """
    (theta, theta_dot, x, x_dot), (theta_d, theta_d_dot, _, x_d, x_d_dot, _, _) = state, reference
    delta_theta = (theta_dot - theta_d_dot) + gains.Lambda_theta * (theta - theta_d)
    return delta_theta, (x_dot - x_d_dot) + gains.Lambda_x * (x - (anchor + x_d))


def adaptive(
    profile: Profile = PROPOSED,
    *,
    Lambda_theta: float = PUBLISHED.Lambda_theta,
    Lambda_x: float = PUBLISHED.Lambda_x,
    K1: float = PUBLISHED.K1,
    K2: float = PUBLISHED.K2,
    K3: float = PUBLISHED.K3,
    Gamma_1: float = PUBLISHED.Gamma_1,
    Gamma_2: float = PUBLISHED.Gamma_2,
    regularised: bool = True,
    beta: float | None = None,
    n: int | None = None,
    eta_0: float | None = None,
    dt: float = LAW_DT,
    nominal: Capsule = NOMINAL,
    name: str = "adaptive",
) -> Controller:
    """The adaptive variable-structure law (39) along a profile, with the published gains by
    default.

    In the regularised form x_d starts from the platform at every cycle, sgn(delta_theta) is a
    saturation, beta is 1, and estimates and eta are bounded. `adaptive_as_published` describes the
    unregularised form.

    Args:
        profile: reference of the pendulum.
        Lambda_theta: bandwidth of the filter of the pendulum's error, 1/s.
        Lambda_x: bandwidth of the filter of the platform's error, 1/s.
        K1: gain of delta_theta, N m s/rad.
        K2: gain of the switching term, N s.
        K3: gain of the non-collocated terms, N s/m.
        Gamma_1: rate of adaptation of alpha_theta.
        Gamma_2: rate of adaptation of alpha_x.
        regularised: False for the corrected law without regularisation.
        beta: beta of (39c) and (39d), rad^2/s^2, > 0; None for the form's `Choices.beta`.
        n: n of the exponent in (39d), at least 1; None for the form's value.
        eta_0: initial auxiliary variable, > 0 and at most `Choices.eta_bound`; None for the form's
            value.
        dt: period of the law and of its Euler steps, s. It divides the period of the profile, and
            the environment's `physics_dt` divides it.
        nominal: the nominal plant, from which the estimates start.
        name: name of the controller.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range.
    """
    given = Gains(Lambda_theta, Lambda_x, K1, K2, K3, Gamma_1, Gamma_2)
    gains = Gains(**check_gains(**given._asdict()))
    if not isinstance(regularised, bool):
        raise TypeError(f"regularised must be True or False, got {regularised!r}")
    choices = REGULARISED if regularised else UNREGULARISED
    if beta is not None:
        accepted = "a finite number > 0 (rad^2/s^2)"
        choices = choices._replace(beta=check_number("beta", beta, accepted, 0.0, open_low=True))
    if n is not None:
        choices = choices._replace(n=check_count("n", n))
    if eta_0 is not None:
        accepted, bound = f"a number > 0 and <= {choices.eta_bound:g}", choices.eta_bound
        choices = choices._replace(
            eta_0=check_number("eta_0", eta_0, accepted, 0.0, bound, open_low=True)
        )
    plant = nominal.plant()
    table = reference_table(profile, plant, dt)
    constants = constants_of(gains, choices, plant, table, float(dt))
    # The first call begins a cycle and starts x_d from 0.
    anchor = 0.0 if choices.anchored else -constants["cycle_advance"]
    memory = (*nominal_estimates(plant), root_of_eta(choices.eta_0, choices.n), anchor)
    return Controller(name, CoreLaw("adaptive", **constants), table, memory, float(dt))


def adaptive_as_published() -> Controller:
    """The adaptive law with corrected equations and without regularisation.

    Corrections, which follow from the paper's own derivation: the tilde of the errors in (37a); the
    minus of both regressors in (38), and m l sin(theta) theta' rho_theta as the last term of N_x;
    the norm in (39c) includes alpha^_x; the norm in (39d) is that of (41); (2n + 2) / (2n + 1) in
    (39d) is an exponent of eta.

    Choices that the paper leaves open (`UNREGULARISED` of the module `gains`): beta = 0.01, n = 1,
    eta(0) = 1 and sgn(0) = 0; eta is limited to [0, 1e6]; (39d) and (39e) are integrated by Euler
    steps at 1 kHz with constant torque in between; the normal force in Y_x is that of the nominal
    plant with theta_d'' for theta'', and not below zero; the estimates start at the nominal values
    and are not limited; x_d is the motion of the nominal platform along theta_d from the start of
    the episode.
    """
    return adaptive(regularised=False, name="adaptive-as-published")


def adaptive_optimal_profile() -> Controller:
    """The adaptive law along the fastest profile (9) that satisfies Principles 1 to 4 with 1.5 N
    m.
    """
    return adaptive(optimal(1.5), name="adaptive-optimal-profile")
