"""An independent reference for the plant.

It does not use the equations of `capsule_gym`. Its equations are typed again from the paper, corrected, and
solved differently: the first row of Eq. (1) gives theta'' in terms of x'', the normal force is linear in x'', and the
second row then contains only x''. `simulate` integrates the smooth phases of contact (slip = +1, -1 or 0 for stick) one
after another with SciPy's DOP853, of eighth order. It searches for the end of a phase on samples of the dense output of
every step, so that it also finds a phase that leaves and re-enters its domain within one step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

from capsule_gym.parameters import Plant

RTOL = 2e-13
ATOL = 1e-15
SAMPLES = 9


class Trajectory(NamedTuple):
    """The result of `simulate`; row i of the arrays belongs to the time i * hold.

    Attributes:
        states: theta, theta_dot, x, x_dot.
        forward: distance moved forwards so far, m.
        backward: distance moved backwards so far, m.
        stuck: time in stick so far, s.
        swept: integral of |theta_dot| so far, rad.
        normal: smallest normal force at the integrator's points in the control interval that ends at that time, N; the
            first row is infinite.
        events: (time, phase before, phase after) of every change of phase within a control interval.
    """

    states: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    stuck: np.ndarray
    swept: np.ndarray
    normal: np.ndarray
    events: list[tuple[float, float, float]]


def rates(theta: float, omega: float, v: float, slip: float, u: float, p: Plant) -> tuple[float, float, float]:
    """Computes theta'', x'' and the normal force in one phase of contact."""
    s = math.sin(theta)
    c = math.cos(theta)
    ratio = min(1.0, max(-1.0, omega))
    u -= p.motor_friction * (35.0 * ratio - 35.0 * ratio**3 + 21.0 * ratio**5 - 5.0 * ratio**7) / 16.0
    internal = p.k * theta + p.c * omega
    # theta'' on a platform that does not accelerate
    free = (u - internal + p.m * p.l * (p.g * s + p.downhill * c)) / (p.m * p.l**2)
    weight = (p.M + p.m) * p.g - p.pivot_torque_on_contact * internal * s
    normal_rest = weight - p.m * p.l * (free * s + omega**2 * c)
    load = p.m * p.l * (free * c - omega**2 * s) - (p.M + p.m) * p.downhill - p.viscous * v
    if slip == 0.0:
        return free, 0.0, normal_rest
    mu = p.mu if slip > 0.0 else p.mu * p.backward_ratio
    mu *= 1.0 + p.stribeck_excess / (1.0 + (v * p.stribeck_rate) ** 2)
    # theta'' = free + cos x'' / l and N = normal_rest - m sin cos x'', so that x'' is the only unknown.
    inertia = p.M + p.m * s**2
    x_ddot = (load - slip * mu * normal_rest) / (inertia - slip * mu * p.m * s * c)
    normal = normal_rest - p.m * s * c * x_ddot
    if normal < 0.0:
        x_ddot = load / inertia
        normal = 0.0
    return free + c * x_ddot / p.l, x_ddot, normal


def margins(theta: float, omega: float, u: float, p: Plant) -> tuple[float, float]:
    """The margins between the static limit and the load on a platform at rest, forwards and backwards, in N."""
    alpha, _, normal = rates(theta, omega, 0.0, 0.0, u, p)
    load = p.m * p.l * (alpha * math.cos(theta) - omega**2 * math.sin(theta)) - (p.M + p.m) * p.downhill
    limit = p.static_ratio * p.mu * max(0.0, normal)
    return limit - load, p.backward_ratio * limit + load


def phase_at_rest(theta: float, omega: float, u: float, p: Plant) -> float:
    """The phase of a platform at rest: stick below the static limit, otherwise slip in the direction of the load."""
    forwards, backwards = margins(theta, omega, u, p)
    if forwards < 0.0:
        return 1.0
    return -1.0 if backwards < 0.0 else 0.0


def _first_crossing(
    event: Callable[[np.ndarray], float], dense: Callable[[float], np.ndarray], start: float, end: float
) -> float | None:
    """The first time in (start, end] at which the event function turns negative; at the start it may be zero."""

    def g(t: float) -> float:
        return event(dense(t))

    times = np.linspace(start, end, SAMPLES)
    values = [g(t) for t in times]
    negative = next((i for i in range(1, SAMPLES) if values[i] < 0.0), None)
    if negative is None:
        for i in range(1, SAMPLES - 1):
            rise = max(values[i - 1], values[i + 1]) - values[i]
            if values[i] <= min(values[i - 1], values[i + 1]) and values[i] < rise:
                low = minimize_scalar(g, bounds=(times[i - 1], times[i + 1]), method="bounded", options={"xatol": 1e-9})
                if low.fun < 0.0:
                    return float(brentq(g, times[i - 1], low.x, xtol=1e-17, rtol=1e-15))
        return None
    left, right = times[negative - 1], times[negative]
    if values[negative - 1] <= 0.0:
        # The phase starts on its boundary: the bracket is valid only after g has left zero.
        for _ in range(60):
            middle = 0.5 * (left + right)
            if g(middle) > 0.0:
                left = middle
                break
            right = middle
        else:
            raise RuntimeError("a phase of contact ends where it starts")
    return float(brentq(g, left, right, xtol=1e-17, rtol=1e-15))


def _swept(y0: np.ndarray, y1: np.ndarray, dense: Callable | None, t0: float, t1: float) -> float:
    """Integral of |theta_dot| over one step of the integrator, in which theta_dot changes sign once at most."""
    # Signs are from the dense output: without friction the pendulum turns exactly when the platform reverses.
    if dense is None or dense(t0)[1] * dense(t1)[1] >= 0.0:
        return abs(y1[0] - y0[0])
    turn = dense(brentq(lambda t: dense(t)[1], t0, t1, xtol=1e-17))[0]
    return abs(turn - y0[0]) + abs(y1[0] - turn)


def simulate(torques: Sequence[float] | np.ndarray, state: Sequence[float], p: Plant, hold: float = 0.02) -> Trajectory:
    """Integrates the plant under torques in N m, each held for `hold` seconds.

    Returns:
        States and integrals at every multiple of `hold`; a state is theta, theta_dot, x, x_dot.
    """
    n = len(torques)
    states, sums, normals = np.empty((n + 1, 4)), np.zeros((n + 1, 4)), np.full(n + 1, math.inf)
    events: list[tuple[float, float, float]] = []
    y = np.array(state, dtype=float)
    states[0] = y
    for i, u in enumerate(float(value) for value in torques):
        sums[i + 1] = sums[i]
        slip = math.copysign(1.0, y[3]) if y[3] != 0.0 else phase_at_rest(y[0], y[1], u, p)
        t = 0.0
        first = len(events)
        while t < hold:
            if len(events) - first > 100:
                raise RuntimeError(f"the phases of contact chatter at t = {i * hold + t}")
            t_1, y_1, normal, ended, swept = _phase(t, y, hold, slip, u, p)
            normals[i + 1] = min(normals[i + 1], normal)
            moved = y_1[2] - y[2]
            sums[i + 1] += (max(0.0, moved), max(0.0, -moved), t_1 - t if slip == 0.0 else 0.0, swept)
            t, y = t_1, y_1
            if ended:
                if slip == 0.0:
                    forwards, backwards = margins(y[0], y[1], u, p)
                    following = 1.0 if forwards < backwards else -1.0
                else:
                    y[3] = 0.0
                    following = phase_at_rest(y[0], y[1], u, p)
                events.append((i * hold + t, slip, following))
                slip = following
        states[i + 1] = y
    forward, backward, stuck, swept = sums.T
    return Trajectory(states, forward, backward, stuck, swept, normals, events)


def _phase(
    t: float, y: np.ndarray, end: float, slip: float, u: float, p: Plant
) -> tuple[float, np.ndarray, float, bool, float]:
    """Integrates one phase, at most until `end`: time, state, smallest N, whether the phase ended, swept angle."""

    def f(_: float, y: np.ndarray) -> tuple[float, float, float, float]:
        theta, omega, _x, v = y.tolist()
        alpha, accel, _normal = rates(theta, omega, v, slip, u, p)
        return omega, alpha, v, accel

    def g(y: np.ndarray) -> float:
        return min(margins(y[0], y[1], u, p)) if slip == 0.0 else slip * y[3]

    solver = DOP853(f, t, y, end, rtol=RTOL, atol=ATOL, first_step=end - t)
    _, accel, normal = rates(y[0], y[1], y[3], slip, u, p)
    swept = 0.0
    while solver.status == "running":
        message = solver.step()
        if solver.status == "failed":
            raise RuntimeError(message)
        t_0, y_0, t_1, y_1 = solver.t_old, solver.y_old, solver.t, solver.y
        _, accel_1, normal_1 = rates(y_1[0], y_1[1], y_1[3], slip, u, p)
        normal = min(normal, normal_1)
        crossing = None
        dense: Any = None
        # A platform that is too fast to stop within the step cannot end its phase.
        slow = min(slip * y_0[3], slip * y_1[3]) < 3.0 * (t_1 - t_0) * max(abs(accel), abs(accel_1)) + 1e-6
        if slip == 0.0 or slow or y_0[1] * y_1[1] < 0.0:
            dense = solver.dense_output()
        if slip == 0.0 or slow:
            crossing = _first_crossing(g, dense, t_0, t_1)
        if crossing is not None and crossing < t_1:
            # Steps again up to the event, since the dense output has a lower order than the steps.
            again = DOP853(f, t_0, y_0, crossing, rtol=RTOL, atol=ATOL, first_step=crossing - t_0)
            while again.status == "running":
                again.step()
            y_1 = again.y
            if slip != 0.0:
                rate = np.array(f(crossing, y_1))
                correction = -y_1[3] / rate[3]
                if abs(correction) < 1e-9:
                    crossing += correction
                    y_1 = y_1 + correction * rate
            return crossing, y_1, normal, True, swept + _swept(y_0, y_1, dense, t_0, crossing)
        swept += _swept(y_0, y_1, dense, t_0, t_1)
        accel = accel_1
    return end, solver.y.copy(), normal, False, swept
