"""The adaptive variable-structure law (37) to (39) of the paper, term by term and in one call.

Symbols are those of the paper. Misprinted equations are corrected, and a comment marks each correction. The functions
are arithmetic on scalars and tuples in SI units, compiled into the law (`baselines.laws.adaptive`); `sliding_variables`
also takes the arrays of a recorded run.
"""

from __future__ import annotations

from typing import NamedTuple

from baselines.laws.gains import Gains
from baselines.laws.reference import COLUMNS
from capsule_gym import dynamics
from capsule_gym.compilation import inlined
from capsule_gym.elementary import sincos
from capsule_gym.parameters import Plant

# The memory: the estimates of alpha_theta and alpha_x, the (2n + 1)-th root of eta, and the start of x_d, m.
MEMORY = (
    *(f"alpha_theta_{i}" for i in range(1, 6)),
    *(f"alpha_x_{i}" for i in range(1, 5)),
    "eta_root",
    "x_anchor",
)
THETA_D_DDOT, CYCLE_START = COLUMNS.index("theta_d_ddot"), COLUMNS.index("cycle_start")


class Constants(NamedTuple):
    """The inputs of (37) to (39) other than the state, the memory and the reference.

    Attributes:
        plant: the nominal one, for the normal force in Y_x.
        gains: see `Gains`.
        beta: see `Choices`, also for the next two.
        n: at least 1.
        saturation_width: rad/s.
        root_bound: the largest root of eta.
        lowest: bounds of the nine estimates from below, in the order of `MEMORY`.
        highest: bounds from above.
        anchored: see `Choices`.
        cycle_advance: distance that x_d covers in a cycle, m.
        dt: period of the law, s.
    """

    plant: Plant
    gains: Gains
    beta: float
    n: int
    saturation_width: float
    root_bound: float
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    anchored: bool
    cycle_advance: float
    dt: float


class Sliding(NamedTuple):
    """The variables of (37).

    Attributes:
        e_x: x - x_d, m.
        rho_theta: rad/s.
        rho_theta_dot: rad/s^2.
        rho_x_dot: m/s^2.
        delta_theta: rad/s.
        delta_x: m/s.
    """

    e_x: float
    rho_theta: float
    rho_theta_dot: float
    rho_x_dot: float
    delta_theta: float
    delta_x: float


class Terms(NamedTuple):
    """The quantities that the law computes at one call.

    Attributes:
        e_x: x - x_d, m.
        delta_theta: rad/s.
        delta_x: m/s.
        Y_theta: regressor of the pendulum, five entries.
        Y_x: regressor of the platform, four entries.
        T_c: N m.
        T_n: N m.
        power: delta_x Y_x alpha^_x, W.
        root_rate: rate of the root of eta, 1/s.
    """

    e_x: float
    delta_theta: float
    delta_x: float
    Y_theta: tuple[float, ...]
    Y_x: tuple[float, ...]
    T_c: float
    T_n: float
    power: float
    root_rate: float


@inlined
def sliding_variables(
    theta: float, theta_dot: float, x: float, x_dot: float, anchor: float, reference: tuple[float, ...], gains: Gains
) -> Sliding:
    """Eq. (37); the printed (37a) lacks the tilde of the errors. x_d starts from `anchor`, m."""
    theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, _ = reference
    e, e_dot = theta - theta_d, theta_dot - theta_d_dot
    e_x, e_x_dot = x - (anchor + x_d), x_dot - x_d_dot
    return Sliding(
        e_x,
        theta_d_dot - gains.Lambda_theta * e,  # Eq. (37a)
        theta_d_ddot - gains.Lambda_theta * e_dot,
        x_d_ddot - gains.Lambda_x * e_x_dot,
        e_dot + gains.Lambda_theta * e,  # Eq. (37b)
        e_x_dot + gains.Lambda_x * e_x,
    )


@inlined
def regressors(
    theta: float, theta_dot: float, x_dot: float, theta_d_ddot: float, s: Sliding, p: Plant
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Y_theta and Y_x of (38) on the nominal plant, with the sign that makes N = -Y alpha.

    N contains theta'', which a law cannot know before its torque acts; theta_d'' replaces it.
    """
    sin, cos = sincos(theta)
    normal = max(0.0, dynamics.normal_force(theta, theta_dot, theta_d_ddot, p))
    sign_x = 1.0 if x_dot > 0.0 else -1.0 if x_dot < 0.0 else 0.0
    return (
        (s.rho_theta_dot, -cos * s.rho_x_dot, theta, theta_dot, -sin),
        (-cos * s.rho_theta_dot, s.rho_x_dot, normal * sign_x, sin * theta_dot * s.rho_theta),
    )


@inlined
def saturation(value: float, width: float) -> float:
    """The sign of a value, with a ramp of half width `width` in place of the jump; a width of 0.0 keeps the jump."""
    if abs(value) < width:
        return value / width
    return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0


@inlined
def eta_of_root(root: float, n: int) -> float:
    """The auxiliary variable eta from its (2n + 1)-th root."""
    square = root * root
    eta = root
    for _ in range(n):
        eta *= square
    return eta


@inlined
def adaptive_terms(
    theta: float,
    theta_dot: float,
    x: float,
    x_dot: float,
    memory: tuple[float, ...],
    reference: tuple[float, ...],
    constants: Constants,
) -> Terms:
    """The terms of (37) to (39) at one instant.

    With r for the root of eta, (39d) is r' = r^2 delta_theta^2 (..) / ((2n + 1) (delta_theta^2 + beta)). This form
    needs no power function, with which a loop over environments could not be vectorised.

    Args:
        theta: rad.
        theta_dot: rad/s.
        x: m.
        x_dot: m/s.
        memory: the cells of `MEMORY`, with the x_anchor of the present cycle.
        reference: a row of `reference_table`.
        constants: see `Constants`.
    """
    h1, h2, h3, h4, h5, g1, g2, g3, g4, root, anchor = memory
    gains = constants.gains
    s = sliding_variables(theta, theta_dot, x, x_dot, anchor, reference, gains)
    delta_theta, delta_x = s.delta_theta, s.delta_x
    Y_theta, Y_x = regressors(theta, theta_dot, x_dot, reference[THETA_D_DDOT], s, constants.plant)
    y1, y2, y3, y4, y5 = Y_theta
    z1, z2, z3, z4 = Y_x
    T_c = y1 * h1 + y2 * h2 + y3 * h3 + y4 * h4 + y5 * h5 - gains.K1 * delta_theta  # Eq. (39b)
    power = delta_x * (z1 * g1 + z2 * g2 + z3 * g3 + z4 * g4)

    eta = eta_of_root(root, constants.n)
    sgn = saturation(delta_theta, constants.saturation_width)
    share = delta_theta / (delta_theta * delta_theta + constants.beta)
    drift = gains.K3 * delta_x * delta_x
    load = abs(power)  # the norm encloses alpha^_x, as (41) needs it
    T_n = (
        -sgn * abs(delta_x) * (abs(eta) + gains.K2) - (eta + 1.0) * share * drift - (eta - 1.0) * share * load
    )  # Eq. (39c)
    root_rate = root * root * delta_theta * share * (drift + load) / (2 * constants.n + 1)  # Eq. (39d), with the norm
    return Terms(s.e_x, delta_theta, delta_x, Y_theta, Y_x, T_c, T_n, power, root_rate)


@inlined
def clamp(value: float, low: float, high: float) -> float:
    """The nearest number within [low, high]."""
    return min(high, max(low, value))


@inlined
def adaptive_step(
    theta: float,
    theta_dot: float,
    x: float,
    x_dot: float,
    memory: tuple[float, ...],
    reference: tuple[float, ...],
    constants: Constants,
) -> tuple[float, tuple[float, ...]]:
    """The torque (39a) and the next memory: (39d) and (39e) by one Euler step of the law's period.

    The arguments are those of `adaptive_terms`.
    """
    h1, h2, h3, h4, h5, g1, g2, g3, g4, root, anchor = memory
    if reference[CYCLE_START] > 0.0:
        anchor = x if constants.anchored else anchor + constants.cycle_advance
    begun = (h1, h2, h3, h4, h5, g1, g2, g3, g4, root, anchor)
    terms = adaptive_terms(theta, theta_dot, x, x_dot, begun, reference, constants)
    y1, y2, y3, y4, y5 = terms.Y_theta
    z1, z2, z3, z4 = terms.Y_x
    low, high, dt = constants.lowest, constants.highest, constants.dt
    s1, s2 = -dt * constants.gains.Gamma_1 * terms.delta_theta, -dt * constants.gains.Gamma_2 * terms.delta_x
    return terms.T_c + terms.T_n, (
        clamp(h1 + s1 * y1, low[0], high[0]),  # Eq. (39e)
        clamp(h2 + s1 * y2, low[1], high[1]),
        clamp(h3 + s1 * y3, low[2], high[2]),
        clamp(h4 + s1 * y4, low[3], high[3]),
        clamp(h5 + s1 * y5, low[4], high[4]),
        clamp(g1 + s2 * z1, low[5], high[5]),
        clamp(g2 + s2 * z2, low[6], high[6]),
        clamp(g3 + s2 * z3, low[7], high[7]),
        clamp(g4 + s2 * z4, low[8], high[8]),
        clamp(root + dt * terms.root_rate, 0.0, constants.root_bound),
        anchor,
    )
