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
OMEGA_N = NATURAL_FREQUENCY.value
# Half a unit of the last digit of each time in Table 1, s.
ROUNDING = (0.0005, 0.0005, 0.005, 0.05, 0.05, 0.05, 0.05)
# (30) and (31) together are (23) and t6 - t4 = t7 - t5; with P3 from (23), only the latter is tested.
CIRCULAR = "P3 of (23), so only t6 - t4 = t7 - t5 is tested"
ROMAN = ("I", "II", "III", "IV", "V", "VI", "VII")

Times = tuple[float, ...]


def printed_profile() -> list[dict[str, Any]]:
    """Every phase of (9) as printed, with the times of Table 1 and the built profile's V1, P2 and P3.

    omega is pi / (2 t1), with which phase I ends at P1 omega. Phase VI is printed for "[0, t5, t6)"; t5 to t6 is taken.

    Returns:
        By phase: its `name` and `formula`; velocity at its start and end (rad/s) and angle (rad), `printed` and
        `built`; and whether the velocities differ by more than a thousandth of the peak (`deviates`).
    """
    _, t2, t3, t4, t5, t6, _ = TABLE_1
    omega, P3 = _quarter(TABLE_1), PROPOSED.restoring_speed
    formulas: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [
        ("P1 omega sin(omega t)", lambda t: V1 * np.sin(omega * t)),
        ("P1 omega", lambda t: np.full_like(t, V1)),
        ("P1 omega sin(omega t - t2)", lambda t: V1 * np.sin(omega * t - t2)),
        ("(t3 - t) / (t3 - t2) P2", lambda t: (t3 - t) / (t3 - t2) * P2),
        ("(t3 - t) / (t4 - t3) P3", lambda t: (t3 - t) / (t4 - t3) * P3),
        ("-P3", lambda t: np.full_like(t, -P3)),
        ("(t6 - t) / (t5 - t6) P3", lambda t: (t6 - t) / (t5 - t6) * P3),
    ]
    phases, edges = [], (0.0, *TABLE_1)
    for n, (text, formula) in enumerate(formulas):
        t, segment = np.linspace(edges[n], edges[n + 1], 10_001), PROPOSED.segments[n]
        velocity, (begin, end) = formula(t), segment.velocity(np.array([0.0, segment.duration])).tolist()
        printed = (float(velocity[0]), float(velocity[-1]), _integral(velocity, t))
        built = (begin, end, float(segment.turned(np.float64(segment.duration))))
        deviates = max(abs(printed[0] - begin), abs(printed[1] - end)) > 1e-3 * V1
        phase = {"name": ROMAN[n], "formula": text, "printed": printed, "built": built, "deviates": deviates}
        phases.append(phase)
    return phases


def eq_21_p2(t: Times) -> float:
    """Eq. (21): P2 in rad/s, its integrals taken along the profile (9) from -theta_0 with V1 and P2.

    It is the momentum balance (20) between two instants at rest. In print (20) multiplies x' by g, and its integrals
    of k and c appear once over the angle and once over the velocity; (21) keeps the former.
    The bracket of c is the antiderivative between 0 and t3. Derived without its slip, int theta' sin(theta) dt =
    cos(theta(0)) - cos(theta(t3)), it would vanish under the boundary conditions, where theta(t3) = +theta_0.
    """
    s = np.linspace(0.0, t[2], 3001)
    theta, _, _ = seven_phases(t, V1, P2).evaluate(s)
    p, ml = PLANT, PLANT.m * PLANT.l
    int_sin, int_cos = _integral(theta * np.sin(theta), s), _integral(theta * np.cos(theta), s)
    edge = float(theta[-1] * math.sin(theta[-1]) - theta[0] * math.sin(theta[0]))
    pushed = p.mu * (p.M + p.m) * p.g * t[2] - p.mu * p.k * int_sin + p.mu * p.c * (edge - int_cos)
    return pushed / (ml * math.cos(THETA_0) + p.mu * ml * math.sin(THETA_0))


def eq_22_swing(omega: float, t: Times) -> float:
    """Eq. (22), left side: the angle in rad swept until t3 at omega (rad/s); the paper equates it with 2 theta_0.

    The third integral keeps the printed argument omega t - t2, and the last term is not needed: the three integrals
    are the whole angle.
    """
    t1, t2, t3 = t[:3]
    rise = V1 / omega * (1.0 - math.cos(omega * t1))
    fall = V1 / omega * (math.cos(omega * t2 - t2) - math.cos(omega * t3 - t2))
    return rise + V1 * (t2 - t1) + fall - 0.5 * P2 * (math.pi / omega + t2 - t3)


def eq_23_p3(P2: float, t: Times = TABLE_1) -> float:
    """Eq. (23): the P3, rad/s, whose return covers phase IV and 2 theta_0.

    It needs theta(t3) = +theta_0, as the boundary conditions say. The sign before P3 belongs to the direction.
    """
    _, _, t3, t4, t5, t6, t7 = t
    return (0.5 * P2 * (t4 - t3) + 2.0 * THETA_0) / (0.5 * ((t7 - t4) + (t6 - t5)))


def eq_24_t1() -> float:
    """Eq. (24): t1 in s, from Lemma 1 at t1 with theta(t1) = V1 t1, which leaves out the start at -theta_0."""
    bound = ((PLANT.M + PLANT.m) * PLANT.g) ** 2 / (2.0 * PLANT.m * PLANT.l)  # the right side of (10)
    return (bound / V1**3 - PLANT.c) / PLANT.k


def eq_25_t2(omega: float, t: Times, *, falling: bool = False) -> float:
    """Eq. (25): t2, a number of radians that the paper reads as seconds.

    With `falling` the arcsin takes the branch on which the sine falls from V1 to P2, as phase III does; printed is the
    rising one.
    """
    angle = math.asin(P2 / V1)
    return omega * t[2] - (math.pi - angle if falling else angle)


def eq_26_omega(t: Times) -> float:
    """Eq. (26) solved for omega, rad/s: the excitation has gone through N = 1 half period at t3."""
    return math.pi / t[2]


def eq_27_t4(t: Times) -> float:
    """Eq. (27): t4 in s, from the printed Lemma 2 at t3 with theta(t3) = P2 t3."""
    return -P2 / (friction_bound(PLANT) - P2 * P2 - PLANT.k * P2 * t[2] - PLANT.c * P2) + t[2]


def eq_27_p2(t: Times = TABLE_1) -> float:
    """Eq. (27) solved for P2, rad/s: the positive root of a quadratic."""
    half = 0.5 * (PLANT.k * t[2] + PLANT.c - 1.0 / (t[3] - t[2]))
    return math.sqrt(half * half + friction_bound(PLANT)) - half


def eq_28_t5(P3: float) -> float:
    """Eq. (28): t5 in s, from the printed Lemma 2 at t5 with theta(t5) = P3 t5 and theta'(t5) = +P3; it is -P3."""
    return (friction_bound(PLANT) - P3 * P3 - PLANT.c * P3) / (PLANT.k * P3)


def eq_29_p3(P2: float, t: Times) -> float:
    """Eq. (29) solved for P3, rad/s. Equal areas of phases IV and V would read P2 (t4 - t3) = P3 (t5 - t4)."""
    return P2 * (t[4] - t[3]) / (t[3] - t[2])


def eq_30_t6(P2: float, P3: float, t: Times) -> float:
    """Eq. (30): t6 in s."""
    return (4.0 * THETA_0 + t[3] * (P2 + 2.0 * P3) - P2 * t[2]) / (2.0 * P3)


def eq_31_t7(P2: float, P3: float, t: Times) -> float:
    """Eq. (31): t7 in s."""
    return (4.0 * THETA_0 - P2 * t[2] + P2 * t[3] + 2.0 * P3 * t[4]) / (2.0 * P3)


def evaluate_selection() -> list[dict[str, Any]]:
    """The result of each equation, the value that Table 1 implies, and whether they agree.

    Returns:
        By row: the `equation`, the `quantity` that it determines and its `unit`; the value that it `gives` and the one
        that Table 1 states or implies (`implied`); the most by which the rounding of Table 1 can change their
        difference (`rounding`); a `remark`; and whether they agree within the digits of Table 1 (`follows`).
    """
    rows: list[tuple[str, str, str, Callable[[Times], tuple[float, float]], str]] = [
        ("(21)", "P2", "rad/s", lambda t: (eq_21_p2(t), eq_27_p2(t)), "implied by (27) and t4"),
        ("(22)", "swing", "rad", lambda t: (eq_22_swing(OMEGA_N, t), 2 * THETA_0), "omega = omega_n"),
        ("(22)", "swing", "rad", lambda t: (eq_22_swing(eq_26_omega(t), t), 2 * THETA_0), "omega of (26)"),
        ("(22)", "swing", "rad", lambda t: (eq_22_swing(_quarter(t), t), 2 * THETA_0), "omega = pi / (2 t1)"),
        ("(24)", "t1", "s", lambda t: (eq_24_t1(), t[0]), f"at V1 = {V1} rad/s"),
        ("(25)", "t2", "s", lambda t: (eq_25_t2(_quarter(t), t), t[1]), "radians as seconds, as printed"),
        ("(25)", "t2", "s", lambda t: (eq_25_t2(_quarter(t), t, falling=True), t[1]), "on the falling branch"),
        ("(26)", "omega", "rad/s", lambda t: (eq_26_omega(t), _quarter(t)), "against pi / (2 t1) of phase I"),
        ("(26)", "omega", "rad/s", lambda t: (eq_26_omega(t), OMEGA_N), "against the natural frequency"),
        ("(27)", "t4", "s", lambda t: (eq_27_t4(t), t[3]), f"at P2 = {P2} rad/s"),
        ("(27)", "P2", "rad/s", lambda t: (eq_27_p2(t), P2), "solved for P2, against the published swing"),
        ("(28)", "t5", "s", lambda t: (eq_28_t5(_implied_p3(t)), t[4]), "P3 of (23)"),
        ("(29)", "P3", "rad/s", lambda t: (eq_29_p3(eq_27_p2(t), t), _implied_p3(t)), "against (23)"),
        ("(30)", "t6", "s", lambda t: (eq_30_t6(eq_27_p2(t), _implied_p3(t), t), t[5]), CIRCULAR),
        ("(31)", "t7", "s", lambda t: (eq_31_t7(eq_27_p2(t), _implied_p3(t), t), t[6]), CIRCULAR),
    ]
    names, selected = ("equation", "quantity", "unit", "gives", "implied", "rounding", "remark"), []
    for equation, quantity, unit, pair, remark in rows:
        gives, implied = pair(TABLE_1)
        # At the corners of the times within the digits of Table 1.
        corners = itertools.product(*((t - half, t + half) for t, half in zip(TABLE_1, ROUNDING, strict=True)))
        rounding = max(abs((a - b) - (gives - implied)) for a, b in map(pair, corners))
        row = (equation, quantity, unit, gives, implied, rounding, remark)
        selected.append({**dict(zip(names, row, strict=True)), "follows": abs(gives - implied) <= rounding})
    return selected


def boundary_condition() -> dict[str, float]:
    """The condition theta(t3) = +theta_0, on which (23) rests, with the times of Table 1.

    Returns:
        The peak velocity that reaches +theta_0 at t3 (`V1`, rad/s) and the `largest_angle` of its cycle (rad);
        theta(t3) at the published peak velocity (`reached`, rad), and the angle by which a cycle with the P3 of (23)
        fails to close there (`drift`, rad).
    """

    def reached(velocity: float) -> float:
        return float(seven_phases(TABLE_1, velocity, P2).evaluate(np.array([TABLE_1[2]]))[0][0])

    needed, _ = bisect(lambda velocity: reached(velocity) < THETA_0, V1, 4.0 * V1)
    # Phase IV; the angle peaks at its end.
    rest = 0.5 * P2 * (TABLE_1[3] - TABLE_1[2])
    forth = reached(V1) + THETA_0 + rest
    drift = forth * _implied_p3(TABLE_1) / PROPOSED.restoring_speed - forth
    return {"V1": needed, "largest_angle": THETA_0 + rest, "reached": reached(V1), "drift": drift}


def bisect(below: Callable[[float], bool], low: float, high: float, steps: int = 60) -> tuple[float, float]:
    """Two values between which a monotonic condition changes: it holds at the first and not at the second."""
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return low, high


def _quarter(t: Times) -> float:
    """The frequency in rad/s whose quarter period is phase I."""
    return math.pi / (2.0 * t[0])


def _implied_p3(t: Times) -> float:
    """P3 in rad/s as Table 1 implies it: (23) with the P2 of (27)."""
    return eq_23_p3(eq_27_p2(t), t)


def _integral(values: np.ndarray, t: np.ndarray) -> float:
    """The trapezoidal rule on equal steps."""
    return float((values.sum() - 0.5 * (values[0] + values[-1])) * (t[1] - t[0]))
