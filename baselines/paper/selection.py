"""Sect. 3 of the paper: the profile (9) as printed, and the selection of its parameters, Eqs. (20) to (31).

Sect. 3.2 presents the times of Table 1 as the outcome of these equations. `evaluate_selection` compares the result of
each equation with Table 1. The equations are kept as printed, errors included: several add an angle to a velocity times
a time, or a radian to a second. Symbols: V1 = P1 omega; theta_0 = pi/3; N = 1. Times t are t1 to t7 in s.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from baselines.laws.profiles import P2, PROPOSED, TABLE_1, V1, seven_phases
from baselines.paper.principles import THETA_0, friction_bound
from baselines.paper.published import NATURAL_FREQUENCY
from capsule_gym.parameters import NOMINAL

PLANT = NOMINAL.plant()
# Half a unit of the last digit of each time in Table 1, s.
ROUNDING = (0.0005, 0.0005, 0.005, 0.05, 0.05, 0.05, 0.05)
# (30) and (31) together are (23) and t6 - t4 = t7 - t5; with P3 from (23), only the latter is tested.
CIRCULAR = "P3 of (23), so only t6 - t4 = t7 - t5 is tested"
ROMAN = ("I", "II", "III", "IV", "V", "VI", "VII")

Times = tuple[float, ...]


def printed_profile() -> list[dict[str, Any]]:
    """Every phase of (9) as printed, with the times of Table 1 and the built profile's V1, P2 and P3.

    `printed` and `built` are the velocity at its start and end (rad/s) and its angle (rad); it `deviates` if velocities
    differ by more than a thousandth of the peak. omega is pi / (2 t1), with which phase I ends at P1 omega. Phase VI is
    printed for "[0, t5, t6)"; t5 to t6 is taken.
    """
    t1, t2, t3, t4, t5, t6, _ = TABLE_1
    omega, P3 = math.pi / (2.0 * t1), PROPOSED.restoring_speed
    formulas: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "P1 omega sin(omega t)": lambda t: V1 * np.sin(omega * t),
        "P1 omega": lambda t: np.full_like(t, V1),
        "P1 omega sin(omega t - t2)": lambda t: V1 * np.sin(omega * t - t2),
        "(t3 - t) / (t3 - t2) P2": lambda t: (t3 - t) / (t3 - t2) * P2,
        "(t3 - t) / (t4 - t3) P3": lambda t: (t3 - t) / (t4 - t3) * P3,
        "-P3": lambda t: np.full_like(t, -P3),
        "(t6 - t) / (t5 - t6) P3": lambda t: (t6 - t) / (t5 - t6) * P3,
    }
    phases, edges = [], itertools.pairwise((0.0, *TABLE_1))
    for name, text, edge, segment in zip(ROMAN, formulas, edges, PROPOSED.segments, strict=True):
        t = np.linspace(*edge, 10_001)
        velocity, (begin, end) = formulas[text](t), segment.velocity(np.array([0.0, segment.duration])).tolist()
        printed = (float(velocity[0]), float(velocity[-1]), _integral(velocity, t))
        built = (begin, end, float(segment.turned(np.float64(segment.duration))))
        deviates = max(abs(printed[0] - begin), abs(printed[1] - end)) > 1e-3 * V1
        phases.append({"name": name, "formula": text, "printed": printed, "built": built, "deviates": deviates})
    return phases


def eq_23_p3(P2: float, t: Times = TABLE_1) -> float:
    """Eq. (23): the P3, rad/s, whose return covers phase IV and 2 theta_0; it needs theta(t3) = +theta_0."""
    return (0.5 * P2 * (t[3] - t[2]) + 2.0 * THETA_0) / (0.5 * ((t[6] - t[3]) + (t[5] - t[4])))


def eq_27_p2(t: Times = TABLE_1) -> float:
    """Eq. (27), the printed Lemma 2 at t3 with theta(t3) = P2 t3, solved for P2, rad/s."""
    half = 0.5 * (PLANT.k * t[2] + PLANT.c - 1.0 / (t[3] - t[2]))
    return math.sqrt(half * half + friction_bound(PLANT)) - half


def _equations(t: Times) -> list[tuple[str, str, str, float, float, str]]:
    """Equation, quantity, unit, the value that it gives, the one that Table 1 states or implies, and a remark."""
    t1, t2, t3, t4, t5, t6, t7 = t
    p, ml, bound = PLANT, PLANT.m * PLANT.l, friction_bound(PLANT)
    omega, omega_26, omega_n = math.pi / (2.0 * t1), math.pi / t3, NATURAL_FREQUENCY.value
    own_p2 = eq_27_p2(t)
    own_p3 = eq_23_p3(own_p2, t)

    # (21) is the momentum balance (20) between two instants at rest, its integrals taken along (9) with V1 and P2. The
    # bracket of c is the antiderivative between 0 and t3. Derived without its slip, int theta' sin(theta) dt =
    # cos(theta(0)) - cos(theta(t3)), it would vanish under the boundary conditions, where theta(t3) = +theta_0.
    s = np.linspace(0.0, t3, 3001)
    theta, _, _ = seven_phases(t, V1, P2).evaluate(s)
    int_sin, int_cos = _integral(theta * np.sin(theta), s), _integral(theta * np.cos(theta), s)
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
    # (25) gives radians, which the paper reads as seconds; III falls from V1 to P2 on the other branch of the arcsin.
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
        ("(24)", "t1", "s", t1_24, t1, f"at V1 = {V1} rad/s"),
        ("(25)", "t2", "s", omega * t3 - arcsin, t2, "radians as seconds, as printed"),
        ("(25)", "t2", "s", omega * t3 - (math.pi - arcsin), t2, "on the falling branch"),
        ("(26)", "omega", "rad/s", omega_26, omega, "against pi / (2 t1) of phase I"),
        ("(26)", "omega", "rad/s", omega_26, omega_n, "against the natural frequency"),
        ("(27)", "t4", "s", t4_27, t4, f"at P2 = {P2} rad/s"),
        ("(27)", "P2", "rad/s", own_p2, P2, "solved for P2, against the published swing"),
        ("(28)", "t5", "s", t5_28, t5, "P3 of (23)"),
        ("(29)", "P3", "rad/s", p3_29, own_p3, "against (23)"),
        ("(30)", "t6", "s", t6_30, t6, CIRCULAR),
        ("(31)", "t7", "s", t7_31, t7, CIRCULAR),
    ]


def evaluate_selection() -> list[dict[str, Any]]:
    """The value that each equation `gives` and the one that Table 1 states or implies (`implied`).

    `rounding` is the most by which the digits of Table 1 can change their difference; if it is larger, the value
    `follows`.
    """
    # At the corners of the times within the digits of Table 1.
    corners = itertools.product(*((t - half, t + half) for t, half in zip(TABLE_1, ROUNDING, strict=True)))
    differences = np.array([[row[3] - row[4] for row in _equations(t)] for t in (TABLE_1, *corners)])
    roundings = np.abs(differences - differences[0]).max(axis=0).tolist()
    names = ("equation", "quantity", "unit", "gives", "implied", "remark")
    return [
        {**dict(zip(names, row, strict=True)), "rounding": rounding, "follows": abs(row[3] - row[4]) <= rounding}
        for row, rounding in zip(_equations(TABLE_1), roundings, strict=True)
    ]


def boundary_condition() -> dict[str, float]:
    """The condition theta(t3) = +theta_0, on which (23) rests, with the times of Table 1; rad and rad/s.

    `V1` reaches it, with the `largest_angle`. At the published V1 theta(t3) is `reached`, and a cycle with the P3 of
    (23) fails to close by `drift`.
    """

    def reached(velocity: float) -> float:
        return float(seven_phases(TABLE_1, velocity, P2).evaluate(np.array([TABLE_1[2]]))[0][0])

    needed, _ = bisect(lambda velocity: reached(velocity) < THETA_0, V1, 4.0 * V1)
    # Phase IV; the angle peaks at its end.
    rest = 0.5 * P2 * (TABLE_1[3] - TABLE_1[2])
    forth = reached(V1) + THETA_0 + rest
    drift = forth * eq_23_p3(eq_27_p2()) / PROPOSED.restoring_speed - forth
    return {"V1": needed, "largest_angle": THETA_0 + rest, "reached": reached(V1), "drift": drift}


def bisect(below: Callable[[float], bool], low: float, high: float, steps: int = 60) -> tuple[float, float]:
    """Two values between which a monotonic condition changes: it holds at the first and not at the second."""
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return low, high


def _integral(values: np.ndarray, t: np.ndarray) -> float:
    """The trapezoidal rule on equal steps."""
    return float((values.sum() - 0.5 * (values[0] + values[-1])) * (t[1] - t[0]))
