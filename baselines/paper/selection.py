"""Sect. 3.2 of the paper: the selection of the parameters of the profile (9), Eqs. (20) to (31).

It presents the times of Table 1 as the outcome of these equations. They are kept as printed, errors
included: several add an angle to a velocity times a time, or a radian to a second. V1 = P1 omega;
theta_0 = pi/3; N = 1.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import trapezoid

from baselines.paper.principles import NEWTON, THETA_0, friction_bound
from baselines.paper.published import NATURAL_FREQUENCY
from capsule_gym.control.laws.profiles import P2, TABLE_1, V1, seven_phases

Times = tuple[float, ...]

# Half a unit of the last digit of each time in Table 1, s.
ROUNDING = (0.0005, 0.0005, 0.005, 0.05, 0.05, 0.05, 0.05)
# Right side of Lemma 2 on the nominal plant, rad/s^2.
BOUND = friction_bound(NEWTON)
SAMPLES = 3001  # of the integrals


class Comparison(NamedTuple):
    """What an equation gives, and what Table 1 states or implies."""

    equation: str
    quantity: str
    unit: str
    gives: float
    implied: float
    remark: str


def evaluate_selection() -> list[dict[str, Any]]:
    """The value that each equation `gives` and the one that Table 1 states or implies (`implied`).

    `rounding` is the most by which the digits of Table 1 can change their difference; if not less,
    the value `follows`.
    """
    limits = [(t - half, t + half) for t, half in zip(TABLE_1, ROUNDING, strict=True)]
    corners = np.array([_differences(times) for times in itertools.product(*limits)])
    roundings = np.abs(corners - _differences(TABLE_1)).max(axis=0)
    rows = []
    for row, rounding in zip(_compare(TABLE_1), roundings.tolist(), strict=True):
        follows = abs(row.gives - row.implied) <= rounding
        rows.append({**row._asdict(), "rounding": rounding, "follows": follows})
    return rows


def _differences(times: Times) -> np.ndarray:
    return np.array([row.gives - row.implied for row in _compare(times)])


def _compare(times: Times) -> Iterator[Comparison]:
    """All equations for the times t1 to t7, s."""
    _, _, t3, t4, t5, t6, t7 = times
    # (27), the printed Lemma 2 at t3 with theta(t3) = P2 t3, solved for P2.
    pivot = NEWTON.k * t3 + NEWTON.c
    half = 0.5 * (pivot - 1.0 / (t4 - t3))
    own_p2 = math.sqrt(half * half + BOUND) - half
    # (23): the P3 whose return covers phase IV and 2 theta_0.
    returned = 0.5 * own_p2 * (t4 - t3) + 2.0 * THETA_0
    duration = 0.5 * ((t7 - t4) + (t6 - t5))
    own_p3 = returned / duration
    yield from _progressive_stage(times, own_p2)
    yield from _restoring_stage(times, own_p2, own_p3)


def _progressive_stage(times: Times, own_p2: float) -> Iterator[Comparison]:
    """Eqs. (21) to (26), of the phases I to III."""
    t1, t2, t3, *_ = times
    samples = np.linspace(0.0, t3, SAMPLES)
    theta, _, _ = seven_phases(times, V1, P2).evaluate(samples)
    p2 = _p2_of_momentum(samples, theta)
    yield Comparison("(21)", "P2", "rad/s", p2, own_p2, "implied by (27) and t4")

    omega = math.pi / (2.0 * t1)
    omega_26 = math.pi / t3
    rates = {
        "omega = omega_n": NATURAL_FREQUENCY.value,
        "omega of (26)": omega_26,
        "omega = pi / (2 t1)": omega,
    }
    for remark, rate in rates.items():
        yield Comparison("(22)", "swing", "rad", _swing(rate, times), 2.0 * THETA_0, remark)
    condition = f"the condition of (23), at V1 = {V1} rad/s"
    yield Comparison("(23)", "theta(t3)", "rad", float(theta[-1]), THETA_0, condition)

    # (24) is Lemma 1 at t1 with theta(t1) = V1 t1, which leaves out the start at -theta_0.
    weight = (NEWTON.M + NEWTON.m) * NEWTON.g
    limit = weight**2 / (2.0 * NEWTON.m * NEWTON.l)
    t1_24 = (limit / V1**3 - NEWTON.c) / NEWTON.k
    yield Comparison("(24)", "t1", "s", t1_24, t1, f"at V1 = {V1} rad/s")

    # (25) gives radians, which the paper reads as seconds; III falls from V1 to P2 on the other
    # branch of the arcsin.
    rising = math.asin(P2 / V1)
    falling = math.pi - rising
    yield Comparison("(25)", "t2", "s", omega * t3 - rising, t2, "radians as seconds, as printed")
    yield Comparison("(25)", "t2", "s", omega * t3 - falling, t2, "on the falling branch")
    yield Comparison("(26)", "omega", "rad/s", omega_26, omega, "against pi / (2 t1) of phase I")


def _p2_of_momentum(samples: np.ndarray, theta: np.ndarray) -> float:
    """P2 by Eq. (21), with the angle at sampled times until t3.

    It is the momentum balance (20) between two instants at rest, its integrals taken along (9). The
    bracket of c is the antiderivative between 0 and t3; without its slip it would be
    cos(theta(0)) - cos(theta(t3)) = 0.
    """
    p = NEWTON
    ml = p.m * p.l
    int_sin = float(trapezoid(theta * np.sin(theta), samples))
    int_cos = float(trapezoid(theta * np.cos(theta), samples))
    first, last = theta[[0, -1]].tolist()
    edge = last * math.sin(last) - first * math.sin(first)
    duration = float(samples[-1])
    weight_impulse = p.mu * (p.M + p.m) * p.g * duration
    spring_impulse = p.mu * p.k * int_sin
    damper_impulse = p.mu * p.c * (edge - int_cos)
    pushed = weight_impulse - spring_impulse + damper_impulse
    return pushed / (ml * math.cos(THETA_0) + p.mu * ml * math.sin(THETA_0))


def _swing(omega: float, times: Times) -> float:
    """Eq. (22), the angle until t3, which the paper equates with 2 theta_0.

    The third integral keeps the printed omega t - t2, and the last term is not needed: the three
    integrals are the whole angle.
    """
    t1, t2, t3, *_ = times
    amplitude = V1 / omega
    rise = amplitude * (1.0 - math.cos(omega * t1))
    start = math.cos(omega * t2 - t2)
    end = math.cos(omega * t3 - t2)
    fall = amplitude * (start - end)
    last = 0.5 * P2 * (math.pi / omega + t2 - t3)
    return rise + V1 * (t2 - t1) + fall - last


def _restoring_stage(times: Times, own_p2: float, own_p3: float) -> Iterator[Comparison]:
    """Eqs. (27) to (31), of the phases IV to VII."""
    _, _, t3, t4, t5, t6, t7 = times
    k, c = NEWTON.k, NEWTON.c
    deceleration = BOUND - P2 * P2 - k * P2 * t3 - c * P2
    t4_27 = -P2 / deceleration + t3
    yield Comparison("(27)", "t4", "s", t4_27, t4, f"at P2 = {P2} rad/s")
    yield Comparison(
        "(27)", "P2", "rad/s", own_p2, P2, "solved for P2, against the published swing"
    )

    # (28) is the printed Lemma 2 at t5 with theta(t5) = P3 t5 and theta'(t5) = +P3; it is -P3.
    t5_28 = (BOUND - own_p3 * own_p3 - c * own_p3) / (k * own_p3)
    yield Comparison("(28)", "t5", "s", t5_28, t5, "P3 of (23)")

    # (29): equal areas of phases IV and V would read P2 (t4 - t3) = P3 (t5 - t4).
    p3_29 = own_p2 * (t5 - t4) / (t4 - t3)
    yield Comparison("(29)", "P3", "rad/s", p3_29, own_p3, "against (23)")

    swept = 4.0 * THETA_0 + t4 * (own_p2 + 2.0 * own_p3) - own_p2 * t3
    yield Comparison("(30)", "t6", "s", swept / (2.0 * own_p3), t6, "P3 of (23)")

    swept = 4.0 * THETA_0 - own_p2 * t3 + own_p2 * t4 + 2.0 * own_p3 * t5
    remark = "P3 of (23), so only t6 - t4 = t7 - t5 is tested"
    yield Comparison("(31)", "t7", "s", swept / (2.0 * own_p3), t7, remark)
