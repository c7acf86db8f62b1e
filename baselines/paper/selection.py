"""Sect. 3.2 of the paper: the selection of the parameters of the profile (9), Eqs. (20) to (31).

It presents the times of Table 1 as the outcome of these equations. They are kept as printed, errors
included: several add an angle to a velocity times a time, or a radian to a second. V1 = P1 omega;
theta_0 = pi/3; N = 1.
"""

import itertools
import math
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from baselines.paper.principles import THETA_0, friction_bound
from baselines.paper.published import NATURAL_FREQUENCY
from capsule_gym.control.laws.profiles import P2, TABLE_1, V1, seven_phases
from capsule_gym.parameters import NOMINAL

# Half a unit of the last digit of each time in Table 1, s.
ROUNDING = (0.0005, 0.0005, 0.005, 0.05, 0.05, 0.05, 0.05)


def _equations(t: tuple[float, ...]) -> list[tuple[str, str, str, float, float, str]]:
    """Equation, quantity, unit, the value it gives, the one that Table 1 implies, and a remark; t
    are t1 to t7, s.
    """
    t1, t2, t3, t4, t5, t6, t7 = t
    p, ml, bound = NOMINAL.plant(), NOMINAL.m * NOMINAL.l, friction_bound(NOMINAL.plant())
    omega, omega_26, omega_n = math.pi / (2.0 * t1), math.pi / t3, NATURAL_FREQUENCY.value
    # (27), the printed Lemma 2 at t3 with theta(t3) = P2 t3, solved for P2.
    half = 0.5 * (p.k * t3 + p.c - 1.0 / (t4 - t3))
    own_p2 = math.sqrt(half * half + bound) - half
    # (23): the P3 whose return covers phase IV and 2 theta_0.
    own_p3 = (0.5 * own_p2 * (t4 - t3) + 2.0 * THETA_0) / (0.5 * ((t7 - t4) + (t6 - t5)))

    # (21) is the momentum balance (20) between two instants at rest, its integrals taken along (9).
    # The bracket of c is the antiderivative between 0 and t3; without its slip it would be
    # cos(theta(0)) - cos(theta(t3)) = 0.
    s = np.linspace(0.0, t3, 3001)
    theta, _, _ = seven_phases(t, V1, P2).evaluate(s)
    int_sin, int_cos = (float(trapezoid(theta * each(theta), s)) for each in (np.sin, np.cos))
    edge = float(theta[-1] * math.sin(theta[-1]) - theta[0] * math.sin(theta[0]))
    pushed = p.mu * (p.M + p.m) * p.g * t3 - p.mu * p.k * int_sin + p.mu * p.c * (edge - int_cos)
    p2_21 = pushed / (ml * math.cos(THETA_0) + p.mu * ml * math.sin(THETA_0))

    def swing(omega: float) -> float:
        # (22), the angle until t3, which the paper equates with 2 theta_0. The third integral keeps the printed omega t
        # - t2, and the last term is not needed: the three integrals are the whole angle.
        rise = V1 / omega * (1.0 - math.cos(omega * t1))
        fall = V1 / omega * (math.cos(omega * t2 - t2) - math.cos(omega * t3 - t2))
        return rise + V1 * (t2 - t1) + fall - 0.5 * P2 * (math.pi / omega + t2 - t3)

    # (24) is Lemma 1 at t1 with theta(t1) = V1 t1, which leaves out the start at -theta_0.
    t1_24 = (((p.M + p.m) * p.g) ** 2 / (2.0 * p.m * p.l) / V1**3 - p.c) / p.k
    # (25) gives radians, which the paper reads as seconds; III falls from V1 to P2 on the other
    # branch of the arcsin.
    arcsin = math.asin(P2 / V1)
    t4_27 = -P2 / (bound - P2 * P2 - p.k * P2 * t3 - p.c * P2) + t3
    # (28) is the printed Lemma 2 at t5 with theta(t5) = P3 t5 and theta'(t5) = +P3; it is -P3.
    t5_28 = (bound - own_p3 * own_p3 - p.c * own_p3) / (p.k * own_p3)
    # (29): equal areas of phases IV and V would read P2 (t4 - t3) = P3 (t5 - t4).
    p3_29 = own_p2 * (t5 - t4) / (t4 - t3)
    t6_30 = (4.0 * THETA_0 + t4 * (own_p2 + 2.0 * own_p3) - own_p2 * t3) / (2.0 * own_p3)
    t7_31 = (4.0 * THETA_0 - own_p2 * t3 + own_p2 * t4 + 2.0 * own_p3 * t5) / (2.0 * own_p3)
    return [
        ("(21)", "P2", "rad/s", p2_21, own_p2, "implied by (27) and t4"),
        ("(22)", "swing", "rad", swing(omega_n), 2.0 * THETA_0, "omega = omega_n"),
        ("(22)", "swing", "rad", swing(omega_26), 2.0 * THETA_0, "omega of (26)"),
        ("(22)", "swing", "rad", swing(omega), 2.0 * THETA_0, "omega = pi / (2 t1)"),
        (
            "(23)",
            "theta(t3)",
            "rad",
            float(theta[-1]),
            THETA_0,
            f"the condition of (23), at V1 = {V1} rad/s",
        ),
        ("(24)", "t1", "s", t1_24, t1, f"at V1 = {V1} rad/s"),
        ("(25)", "t2", "s", omega * t3 - arcsin, t2, "radians as seconds, as printed"),
        ("(25)", "t2", "s", omega * t3 - (math.pi - arcsin), t2, "on the falling branch"),
        ("(26)", "omega", "rad/s", omega_26, omega, "against pi / (2 t1) of phase I"),
        ("(27)", "t4", "s", t4_27, t4, f"at P2 = {P2} rad/s"),
        ("(27)", "P2", "rad/s", own_p2, P2, "solved for P2, against the published swing"),
        ("(28)", "t5", "s", t5_28, t5, "P3 of (23)"),
        ("(29)", "P3", "rad/s", p3_29, own_p3, "against (23)"),
        ("(30)", "t6", "s", t6_30, t6, "P3 of (23)"),
        ("(31)", "t7", "s", t7_31, t7, "P3 of (23), so only t6 - t4 = t7 - t5 is tested"),
    ]


def evaluate_selection() -> list[dict[str, Any]]:
    """The value that each equation `gives` and the one that Table 1 states or implies (`implied`).

    `rounding` is the most by which the digits of Table 1 can change their difference; if not less,
    the value `follows`.
    """
    corners = itertools.product(
        *((t - half, t + half) for t, half in zip(TABLE_1, ROUNDING, strict=True))
    )
    found = [_equations(t) for t in (TABLE_1, *corners)]
    differences = np.array([[row[3] - row[4] for row in rows] for rows in found])
    roundings = np.abs(differences - differences[0]).max(axis=0).tolist()
    names = ("equation", "quantity", "unit", "gives", "implied", "remark", "rounding", "follows")
    return [
        dict(zip(names, (*row, rounding, abs(row[3] - row[4]) <= rounding), strict=True))
        for row, rounding in zip(found[0], roundings, strict=True)
    ]
