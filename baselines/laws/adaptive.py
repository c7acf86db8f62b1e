"""The paper's control laws as `Controller`s: feedback linearisation (35) and the adaptive variable-structure law (39).

Symbols are the paper's; where its print is wrong the corrected equation stands, and the comment says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from baselines.laws.gains import GAMMA_1, GAMMA_2, K_1, K_2, K_3, LAMBDA_THETA, LAMBDA_X, check_gains
from baselines.laws.profiles import PROPOSED, Profile
from baselines.laws.reference import reference_table
from capsule_gym import dynamics
from capsule_gym.controller import Controller, Law
from capsule_gym.parameters import NOMINAL, Capsule, Plant
from capsule_gym.trigonometry import sincos

# Not published: beta, n and eta(0). eta = 1 takes the positive feedback out of the last term of (39c).
ETA_0 = 1.0
N_EXPONENT = 1
BETA = 1.0
BETA_AS_PUBLISHED = 0.01
# Width in rad/s of the saturation that replaces sgn(delta_theta).
SATURATION_WIDTH = 0.5
# (39d) can grow without bound in finite time, and torques are clipped anyway.
ETA_BOUND = 10.0
ETA_BOUND_AS_PUBLISHED = 1e6
# The regularised law keeps every estimate within this fraction of its nominal value (projection).
ESTIMATE_RANGE = 0.5

MEMORY = (
    *(f"alpha_theta_{i}" for i in range(1, 6)),
    *(f"alpha_x_{i}" for i in range(1, 5)),
    "eta_root",
    "x_anchor",
)


def adaptive_law(
    p: Plant,
    *,
    Lambda_theta: float,
    Lambda_x: float,
    K1: float,
    K2: float,
    K3: float,
    Gamma_1: float,
    Gamma_2: float,
    as_published: bool,
    cycle_advance: float,
) -> Law:
    """The torque (39) with its auxiliary variable and adaptation, integrated by Euler steps of the law's period.

    The memory is `MEMORY`: the estimates of alpha_theta and alpha_x, the (2n + 1)-th root of eta, and where x_d starts
    from. With r for that root (39d) is r' = r^2 delta_theta^2 (..) / ((2n + 1) (delta_theta^2 + beta)), which needs no
    power that a loop over environments could not take.

    Args:
        p: the nominal plant, for the normal force in Y_x and the range of the estimates.
        Lambda_theta: bandwidth of the first-order filter, 1/s.
        Lambda_x: likewise for the platform, 1/s.
        K1: N m s/rad.
        K2: N s.
        K3: gain of the non-collocated terms.
        Gamma_1: rate of adaptation of alpha_theta.
        Gamma_2: rate of adaptation of alpha_x.
        as_published: sgn instead of the saturation, x_d left free, beta small, estimates and eta as they come.
        cycle_advance: distance that x_d covers in a cycle, m.
    """
    dt = 1e-3
    beta = BETA_AS_PUBLISHED if as_published else BETA
    odd = 2 * N_EXPONENT + 1
    root_bound = (ETA_BOUND_AS_PUBLISHED if as_published else ETA_BOUND) ** (1.0 / odd)
    low, high = (-math.inf, math.inf) if as_published else (1.0 - ESTIMATE_RANGE, 1.0 + ESTIMATE_RANGE)
    a1, a2, a3, a4, a5, b1, b2, b3, b4 = nominal_estimates(p)

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, cycle_start = reference
        h1, h2, h3, h4, h5, g1, g2, g3, g4, root, anchor = memory
        if cycle_start > 0.0:
            anchor = anchor + cycle_advance if as_published else x

        eta = root**odd
        sin, cos = sincos(theta)
        e, e_dot = theta - theta_d, theta_dot - theta_d_dot
        e_x, e_x_dot = x - (anchor + x_d), x_dot - x_d_dot
        rho_theta = theta_d_dot - Lambda_theta * e  # Eq. (37a), with the error's tilde that the print lacks
        rho_theta_dot = theta_d_ddot - Lambda_theta * e_dot
        rho_x_dot = x_d_ddot - Lambda_x * e_x_dot
        delta_theta = e_dot + Lambda_theta * e  # Eq. (37b)
        delta_x = e_x_dot + Lambda_x * e_x
        normal = max(0.0, dynamics.normal_force(theta, theta_dot, theta_d_ddot, p))
        sign_x = 1.0 if x_dot > 0.0 else -1.0 if x_dot < 0.0 else 0.0
        # The regressors of (38), with the sign that makes N = -Y alpha.
        y1, y2, y3, y4, y5 = rho_theta_dot, -cos * rho_x_dot, theta, theta_dot, -sin
        z1, z2, z3, z4 = -cos * rho_theta_dot, rho_x_dot, normal * sign_x, sin * theta_dot * rho_theta
        y_alpha = y1 * h1 + y2 * h2 + y3 * h3 + y4 * h4 + y5 * h5
        z_alpha = z1 * g1 + z2 * g2 + z3 * g3 + z4 * g4

        T_c = y_alpha - K1 * delta_theta  # Eq. (39b)
        if as_published:
            sgn = 1.0 if delta_theta > 0.0 else -1.0 if delta_theta < 0.0 else 0.0
        else:
            sgn = min(1.0, max(-1.0, delta_theta / SATURATION_WIDTH))
        share = delta_theta / (delta_theta * delta_theta + beta)
        drift = K3 * delta_x * delta_x
        load = abs(delta_x * z_alpha)  # the norm encloses alpha_x, as (41) needs it
        T_n = (
            -sgn * abs(delta_x) * (abs(eta) + K2) - (eta + 1.0) * share * drift - (eta - 1.0) * share * load
        )  # Eq. (39c)

        root_rate = root * root * delta_theta * share * (drift + load) / odd  # Eq. (39d)
        root = min(root_bound, max(0.0, root + dt * root_rate))
        s1, s2 = -dt * Gamma_1 * delta_theta, -dt * Gamma_2 * delta_x  # Eq. (39e)
        return T_c + T_n, (
            min(high * a1, max(low * a1, h1 + s1 * y1)),
            min(high * a2, max(low * a2, h2 + s1 * y2)),
            min(high * a3, max(low * a3, h3 + s1 * y3)),
            min(high * a4, max(low * a4, h4 + s1 * y4)),
            min(high * a5, max(low * a5, h5 + s1 * y5)),
            min(high * b1, max(low * b1, g1 + s2 * z1)),
            min(high * b2, max(low * b2, g2 + s2 * z2)),
            min(high * b3, max(low * b3, g3 + s2 * z3)),
            min(high * b4, max(low * b4, g4 + s2 * z4)),
            root,
            anchor,
        )

    return law


def nominal_estimates(p: Plant) -> tuple[float, ...]:
    """alpha_theta = [m l^2, m l, k, c, m g l] and alpha_x = [m l, M + m, mu, m l] of a plant."""
    ml = p.m * p.l
    return ml * p.l, ml, p.k, p.c, ml * p.g, ml, p.M + p.m, p.mu, ml


def adaptive(
    profile: Profile = PROPOSED,
    *,
    Lambda_theta: float = LAMBDA_THETA,
    Lambda_x: float = LAMBDA_X,
    K1: float = K_1,
    K2: float = K_2,
    K3: float = K_3,
    Gamma_1: float = GAMMA_1,
    Gamma_2: float = GAMMA_2,
    as_published: bool = False,
    nominal: Capsule = NOMINAL,
    name: str = "adaptive",
) -> Controller:
    """The adaptive variable-structure law (39) along a profile; the published gains are the defaults.

    What the paper leaves open is regularised: x_d starts from the platform at every cycle, sgn is a saturation,
    beta = 1, eta(0) = 1, and estimates and eta are bounded. `as_published` leaves all of that out.

    Args:
        profile: what the pendulum follows.
        Lambda_theta: 1/s.
        Lambda_x: 1/s.
        K1: N m s/rad.
        K2: N s.
        K3: gain of the non-collocated terms.
        Gamma_1: rate of adaptation of alpha_theta.
        Gamma_2: rate of adaptation of alpha_x.
        as_published: the law as printed.
        nominal: the plant that the law starts from.
        name: the controller's name.
    """
    gains = check_gains(
        Lambda_theta=Lambda_theta, Lambda_x=Lambda_x, K1=K1, K2=K2, K3=K3, Gamma_1=Gamma_1, Gamma_2=Gamma_2
    )
    plant = nominal.plant()
    table = reference_table(profile, plant)
    # One row short of the cycle, where the platform rests: nothing is lost.
    cycle_advance = float(table[-1, 3])
    law = adaptive_law(plant, as_published=bool(as_published), cycle_advance=cycle_advance, **gains)
    anchor = -cycle_advance if as_published else 0.0
    return Controller(name, law, table, initial_memory(plant, anchor))


def adaptive_as_published() -> Controller:
    """The adaptive law as printed."""
    return adaptive(as_published=True, name="adaptive-as-published")


def compliant() -> Controller:
    """The adaptive law with a feedback that gives way: it tracks by its feed-forward and lets a residual through.

    K1 Lambda_theta is 0.2 N m/rad instead of 15.6, and the non-collocated terms, which fight any motion of the
    platform that the reference does not know, are off.
    """
    return adaptive(Lambda_theta=4.0, K1=0.05, K2=0.0, K3=0.0, Gamma_1=0.0, Gamma_2=0.0, name="compliant")


def initial_memory(p: Plant, anchor: float) -> tuple[float, ...]:
    """The adaptive law's memory before its first call.

    Args:
        p: the plant that the law starts from.
        anchor: where x_d starts from, m.
    """
    return (*nominal_estimates(p), ETA_0 ** (1.0 / (2 * N_EXPONENT + 1)), anchor)


def eta_of(memory: np.ndarray) -> np.ndarray:
    """The auxiliary variable eta out of memories of the adaptive law, shape (.., cells)."""
    return memory[..., MEMORY.index("eta_root")] ** (2 * N_EXPONENT + 1)


def describe_memory(memory: Sequence[float]) -> dict[str, float]:
    """The adaptive law's memory by name: estimates, eta and the anchor of x_d."""
    cells = dict(zip(MEMORY, memory, strict=True))
    del cells["eta_root"]
    return {**cells, "eta": float(eta_of(np.array(memory)))}
