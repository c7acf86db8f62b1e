"""The paper's adaptive variable-structure law (37) to (39), regularised or corrected only."""

import math
from collections.abc import Sequence
from decimal import Context, Decimal
from typing import Any

import numpy as np

from capsule_gym.checks import check_count, check_flag, check_number
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
from capsule_gym.core import _core
from capsule_gym.parameters import NOMINAL, Capsule, Plant

# The cells of the memory: the estimates, the (2n + 1)-th root of eta, and the start of x_d, m.
MEMORY = (
    "alpha_theta_1",
    "alpha_theta_2",
    "alpha_theta_3",
    "alpha_theta_4",
    "alpha_theta_5",
    "alpha_x_1",
    "alpha_x_2",
    "alpha_x_3",
    "alpha_x_4",
    "eta_root",
    "x_anchor",
)


def nominal_estimates(p: Plant) -> tuple[float, ...]:
    """alpha_theta = [m l^2, m l, k, c, m g l] and alpha_x = [m l, M + m, mu, m l] of a plant."""
    ml = p.m * p.l
    alpha_theta = ml * p.l, ml, p.k, p.c, ml * p.g
    alpha_x = ml, p.M + p.m, p.mu, ml
    return alpha_theta + alpha_x


def constants_of(
    gains: Gains, choices: Choices, plant: Plant, table: np.ndarray, dt: float
) -> dict[str, Any]:
    """The constants of the law by their names in the core; `table` is from `reference_table`."""
    lowest, highest = estimate_bounds(plant, choices.estimate_range)
    # The platform rests from the last row, one step before the end of the cycle, to the end.
    cycle_advance = float(table[-1, COLUMNS.index("x_d")])
    return {
        **plant_constants(plant),
        **gains._asdict(),
        "beta": choices.beta,
        "n": choices.n,
        "saturation_width": choices.saturation_width,
        "root_bound": root_of_eta(choices.eta_bound, choices.n),
        "lowest": lowest,
        "highest": highest,
        "anchored": choices.anchored,
        "cycle_advance": cycle_advance,
        "dt": dt,
    }


def estimate_bounds(plant: Plant, share: float) -> tuple[list[float], list[float]]:
    """The bounds of the estimates, which may differ from their nominal values by this share."""
    nominal = nominal_estimates(plant)
    if math.isinf(share):
        # Not a product: zero times infinity is NaN.
        return [-math.inf] * len(nominal), [math.inf] * len(nominal)
    low, high = 1.0 - share, 1.0 + share
    return [low * estimate for estimate in nominal], [high * estimate for estimate in nominal]


def root_of_eta(eta: float, n: int) -> float:
    """The (2n + 1)-th root of the auxiliary variable, which the memory holds.

    The root is computed in decimal arithmetic: the last digit of a float's power depends on the C
    library.
    """
    exact = Context(prec=40)
    exponent = exact.divide(1, 2 * n + 1)
    return float(exact.power(Decimal(eta), exponent))


def eta_of(memory: np.ndarray, n: int = REGULARISED.n) -> np.ndarray:
    """The auxiliary variable eta from memories of the adaptive law, shape (.., cells)."""
    root = memory[..., MEMORY.index("eta_root")]
    return math.prod([root * root] * n, start=root)


def sliding_variables(
    state: Sequence[np.ndarray], anchor: np.ndarray, reference: np.ndarray, gains: Gains
) -> tuple[np.ndarray, np.ndarray]:
    """delta_theta (rad/s) and delta_x (m/s).

    Args:
        state: theta, theta_dot, x and x_dot.
        anchor: the position from which x_d starts, m.
        reference: the values of `COLUMNS`.
        gains: the gains of the law.
    """
    theta, theta_dot, x, x_dot = state
    theta_d, theta_d_dot, _, x_d, x_d_dot, _, _ = reference
    # Eq. (37b)
    delta_theta = (theta_dot - theta_d_dot) + gains.Lambda_theta * (theta - theta_d)
    delta_x = (x_dot - x_d_dot) + gains.Lambda_x * (x - (anchor + x_d))
    return delta_theta, delta_x


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
    """The adaptive variable-structure law (39) along a profile.

    The default gains are the published ones. In the regularised form x_d starts from the platform
    at every cycle, sgn(delta_theta) is a saturation, beta is 1, and estimates and eta are bounded.
    `adaptive_as_published` describes the unregularised form.

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
    gains = Gains(Lambda_theta, Lambda_x, K1, K2, K3, Gamma_1, Gamma_2)
    gains = Gains(**check_gains(**gains._asdict()))
    choices = REGULARISED if check_flag("regularised", regularised) else UNREGULARISED
    if beta is not None:
        accepted = "a finite number > 0 (rad^2/s^2)"
        beta = check_number("beta", beta, accepted, 0.0, open_low=True)
        choices = choices._replace(beta=beta)
    if n is not None:
        choices = choices._replace(n=check_count("n", n, _core.MOST_N))
    if eta_0 is not None:
        bound = choices.eta_bound
        accepted = f"a number > 0 and <= {bound:g}"
        eta_0 = check_number("eta_0", eta_0, accepted, 0.0, bound, open_low=True)
        choices = choices._replace(eta_0=eta_0)
    plant = nominal.plant()
    table = reference_table(profile, plant, dt)
    constants = constants_of(gains, choices, plant, table, float(dt))
    # The first call begins a cycle and starts x_d from 0.
    anchor = 0.0 if choices.anchored else -constants["cycle_advance"]
    eta_root = root_of_eta(choices.eta_0, choices.n)
    memory = (*nominal_estimates(plant), eta_root, anchor)
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
    """The adaptive law along the fastest profile (9) with 1.5 N m and Principles 1 to 4."""
    return adaptive(optimal(1.5), name="adaptive-optimal-profile")
