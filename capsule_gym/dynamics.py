"""The physics, once: plain scalar functions of SI quantities that numba compiles for every use.

The plant is model.md's corrected Eq. (1), with q = [theta, x] and the friction force f:

    m l^2 theta'' - m l cos(theta) x'' - m g l sin(theta) + k theta + c theta' = u
    (M + m) x'' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = 0

Within a phase of contact the motion is smooth. `slip` names the phase: +1.0 forwards, -1.0 backwards, 0.0 stick.
The phase follows from the state alone: the platform sticks only where x_dot is exactly 0.0.

Every function is ordinary Python; `register_jitable` lets compiled code call it too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba.extending import register_jitable

from capsule_gym.parameters import Plant

# No step holds anywhere near as many events. The cap only keeps a rounding accident from hanging compiled code.
EVENT_LIMIT = 1000
# Size of the event function (m/s in slip, N in stick) that counts as zero: ten times its rounding error.
EVENT_TOLERANCE = 1e-15
ROOT_ITERATIONS = 60
# Share of a step below which a slip that starts and ends at rest counts as none.
VOID_PHASE = 1e-9


class Motion(NamedTuple):
    """One step's result: the new state and what was integrated on the way.

    Attributes:
        theta: angle from the upright, rad.
        theta_dot: its rate, rad/s.
        x: displacement of the platform, m.
        x_dot: its velocity, m/s; exactly 0.0 in stick.
        forward: distance moved forwards, m.
        backward: distance moved backwards, m.
        stuck: time in stick, s.
        swept: integral of |theta_dot|, rad.
        normal_force: the smallest normal force met at the start of a phase, N; 0.0 where contact was lost.
        events: number of phase changes located inside the step.
    """

    theta: float
    theta_dot: float
    x: float
    x_dot: float
    forward: float
    backward: float
    stuck: float
    swept: float
    normal_force: float
    events: int


@register_jitable(forceinline=True)
def kinetic_friction(slip: float, p: Plant) -> float:
    """Friction coefficient while sliding in the direction of `slip` (+1.0 or -1.0)."""
    return p.mu * p.backward_ratio if slip < 0.0 else p.mu


@register_jitable(forceinline=True)
def normal_force(theta: float, theta_dot: float, theta_ddot: float, p: Plant) -> float:
    """Force of the floor on the platform in N, before the clamp at zero: Newton's law on the vertical.

    With the paper's option the pivot's torque is subtracted as (7) prints it.
    """
    sin, cos = math.sin(theta), math.cos(theta)
    newton = (p.M + p.m) * p.g - p.m * p.l * (theta_ddot * sin + theta_dot * theta_dot * cos)
    return newton - p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin  # Eq. (7)


@register_jitable(forceinline=True)
def driving_force(theta: float, theta_dot: float, theta_ddot: float, p: Plant) -> float:
    """Horizontal force in N with which the pendulum pushes a platform that does not accelerate; friction opposes it."""
    return p.m * p.l * (math.cos(theta) * theta_ddot - math.sin(theta) * theta_dot * theta_dot)


@register_jitable(forceinline=True)
def stick_acceleration(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """theta'' in rad/s^2 on a platform at rest: the first row of Eq. (1) with x'' = 0."""
    return (u + p.m * p.g * p.l * math.sin(theta) - p.k * theta - p.c * theta_dot) / (p.m * p.l * p.l)


@register_jitable(forceinline=True)
def _solve(theta: float, theta_dot: float, slip: float, mu: float, u: float, p: Plant) -> tuple[float, float, float]:
    """theta'', x'' and N of Eq. (1) with f = slip mu N, one formula for slip and stick (slip = 0 pins x'' = 0)."""
    sin, cos = math.sin(theta), math.cos(theta)
    ml = p.m * p.l
    total = p.M + p.m
    moving = slip * slip
    rough = slip * mu
    pivot = (p.k * theta + p.c * theta_dot) * p.pivot_torque_on_contact * sin
    torque = u + ml * p.g * sin - p.k * theta - p.c * theta_dot
    rest = total * p.g - ml * theta_dot * theta_dot * cos - pivot
    force = -ml * sin * theta_dot * theta_dot - rough * rest
    # N holds theta'': moving that part to the left turns cos into cos + slip mu sin.
    tilted = ml * (cos + rough * sin)
    determinant = ml * p.l * total - moving * ml * cos * tilted
    theta_ddot = (total * torque + moving * ml * cos * force) / determinant
    x_ddot = moving * (force + tilted * theta_ddot) / total
    return theta_ddot, x_ddot, rest - ml * sin * theta_ddot


@register_jitable(forceinline=True)
def accelerations(theta: float, theta_dot: float, slip: float, u: float, p: Plant) -> tuple[float, float, float]:
    """theta'' in rad/s^2, x'' in m/s^2 and the normal force in N, clamped at zero: a floor does not pull.

    Args:
        theta: angle, rad.
        theta_dot: its rate, rad/s.
        slip: phase of the contact, +1.0, -1.0 or 0.0 (stick).
        u: motor torque, N m.
        p: the plant.
    """
    theta_ddot, x_ddot, normal = _solve(theta, theta_dot, slip, kinetic_friction(slip, p), u, p)
    if normal < 0.0:
        theta_ddot, x_ddot, normal = _solve(theta, theta_dot, slip, 0.0, u, p)
        normal = 0.0
    return theta_ddot, x_ddot, normal


@register_jitable(forceinline=True)
def stick_margin(theta: float, theta_dot: float, u: float, p: Plant) -> tuple[float, float]:
    """Static friction limit minus |driving force|, in N, and the driving force itself: it sticks while >= 0."""
    theta_ddot = stick_acceleration(theta, theta_dot, u, p)
    force = driving_force(theta, theta_dot, theta_ddot, p)
    limit = p.static_ratio * kinetic_friction(force, p) * max(0.0, normal_force(theta, theta_dot, theta_ddot, p))
    return limit - abs(force), force


@register_jitable(forceinline=True)
def contact_phase(theta: float, theta_dot: float, x_dot: float, u: float, p: Plant) -> float:
    """The phase of the contact: the direction of motion, or at rest 0.0 below the static limit, else the load's."""
    if x_dot > 0.0:
        return 1.0
    if x_dot < 0.0:
        return -1.0
    margin, force = stick_margin(theta, theta_dot, u, p)
    if margin >= 0.0:
        return 0.0
    return 1.0 if force > 0.0 else -1.0


@register_jitable(forceinline=True)
def stick_margin_rate(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """Time derivative of `stick_margin` in N/s along a stick phase, at constant torque."""
    sin, cos = math.sin(theta), math.cos(theta)
    ml = p.m * p.l
    a = stick_acceleration(theta, theta_dot, u, p)
    jerk = (ml * p.g * cos * theta_dot - p.k * theta_dot - p.c * a) / (ml * p.l)
    force = driving_force(theta, theta_dot, a, p)
    force_rate = ml * (cos * jerk - 3.0 * sin * theta_dot * a - cos * theta_dot**3)
    normal_rate = -ml * (sin * jerk + 3.0 * cos * theta_dot * a - sin * theta_dot**3)
    pivot_rate = (p.k * theta_dot + p.c * a) * sin + (p.k * theta + p.c * theta_dot) * cos * theta_dot
    normal_rate -= p.pivot_torque_on_contact * pivot_rate
    limit_rate = p.static_ratio * kinetic_friction(force, p) * normal_rate
    return limit_rate - force_rate if force > 0.0 else limit_rate + force_rate


@register_jitable(forceinline=True)
def runge_kutta(
    theta: float, theta_dot: float, x: float, x_dot: float, slip: float, u: float, p: Plant, h: float
) -> tuple[float, float, float, float, float, float]:
    """One classical Runge-Kutta step of h seconds inside one phase; also x'' and N at its start.

    The accelerations do not depend on x and x_dot, so the stages of the positions collapse into sums.
    """
    half = 0.5 * h
    a1, b1, normal = accelerations(theta, theta_dot, slip, u, p)
    a2, b2, _ = accelerations(theta + half * theta_dot, theta_dot + half * a1, slip, u, p)
    a3, b3, _ = accelerations(theta + half * theta_dot + half * half * a1, theta_dot + half * a2, slip, u, p)
    a4, b4, _ = accelerations(theta + h * theta_dot + half * h * a2, theta_dot + h * a3, slip, u, p)
    sixth = h / 6.0
    return (
        theta + h * theta_dot + h * sixth * (a1 + a2 + a3),
        theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        x + h * x_dot + h * sixth * (b1 + b2 + b3),
        x_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4),
        b1,
        normal,
    )


@register_jitable
def _event_function(
    theta: float, theta_dot: float, x: float, x_dot: float, slip: float, u: float, p: Plant, tau: float
) -> float:
    """What must stay positive for the phase to last, tau seconds after the given state."""
    theta, theta_dot, x, x_dot, _, _ = runge_kutta(theta, theta_dot, x, x_dot, slip, u, p, tau)
    if slip == 0.0:
        return stick_margin(theta, theta_dot, u, p)[0]
    return slip * x_dot


@register_jitable
def _dip(before: float, slope: float, after: float, h: float) -> float:
    """Where the parabola with that start, slope and end has its minimum in (0, h); h where it has none."""
    curvature = after - before - slope * h
    if curvature <= 0.0:
        return h
    return min(h, -0.5 * slope * h * h / curvature)


@register_jitable
def _locate(
    theta: float,
    theta_dot: float,
    x: float,
    x_dot: float,
    slip: float,
    u: float,
    p: Plant,
    low: float,
    g_low: float,
    high: float,
    g_high: float,
) -> float:
    """Time at which the phase ends: the Illinois method on the event function of re-taken Runge-Kutta steps.

    Every trial is a full step from the phase's start, so the event is as accurate as the integrator itself.
    """
    width = high
    tau = high
    for _ in range(ROOT_ITERATIONS):
        tau = high - g_high * (high - low) / (g_high - g_low)
        g = _event_function(theta, theta_dot, x, x_dot, slip, u, p, tau)
        if abs(g) <= EVENT_TOLERANCE or high - low <= 1e-14 * width:
            break
        if g < 0.0:
            if g_high < 0.0 and high != width:
                g_low *= 0.5
            high, g_high = tau, g
        else:
            if low != 0.0:
                g_high *= 0.5
            low, g_low = tau, g
    return tau


@register_jitable
def _event_time(
    theta: float,
    theta_dot: float,
    x: float,
    x_dot: float,
    slip: float,
    u: float,
    p: Plant,
    before: float,
    slope: float,
    after: float,
    h: float,
) -> float:
    """Time in (0, h) at which the phase ends, or h if it lasts.

    Args:
        theta: angle at the start of the step, rad; likewise the next three.
        theta_dot: rad/s.
        x: m.
        x_dot: m/s.
        slip: the phase.
        u: torque, N m.
        p: the plant.
        before: event function at the start.
        slope: its time derivative there.
        after: event function at the end.
        h: length of the step, s.
    """
    high, g_high = h, after
    if after >= 0.0:
        high = _dip(before, slope, after, h)
        if high >= h:
            return h
        g_high = _event_function(theta, theta_dot, x, x_dot, slip, u, p, high)
        if g_high >= 0.0:
            return h
    low, g_low = 0.0, before
    if before <= EVENT_TOLERANCE:
        # A phase that starts at its own boundary: the bracket is void until the event function has left zero.
        low = high
        for _ in range(ROOT_ITERATIONS):
            low *= 0.5
            g_low = _event_function(theta, theta_dot, x, x_dot, slip, u, p, low)
            if g_low > 0.0:
                break
            high, g_high = low, g_low
        if g_low <= 0.0:
            return high
    return _locate(theta, theta_dot, x, x_dot, slip, u, p, low, g_low, high, g_high)


@register_jitable(forceinline=True)
def _swept(start: float, end: float, turned: float, h: float) -> float:
    """Integral of |theta_dot| over h seconds that turned the pendulum by `turned`; theta_dot went from start to end."""
    if start * end >= 0.0:
        return abs(turned)
    return 0.5 * h * (start * start + end * end) / (abs(start) + abs(end))


@register_jitable
def step(theta: float, theta_dot: float, x: float, x_dot: float, u: float, p: Plant, h: float) -> Motion:
    """Advances the plant by h seconds at constant torque, through every change of contact phase.

    Args:
        theta: angle from the upright, rad.
        theta_dot: its rate, rad/s.
        x: displacement of the platform, m.
        x_dot: its velocity, m/s.
        u: motor torque, N m.
        p: the plant.
        h: length of the step, s.

    Returns:
        The state afterwards with the integrals of the step.
    """
    forward = backward = stuck = swept = 0.0
    smallest_normal = math.inf
    events = 0
    remaining = h
    slip = contact_phase(theta, theta_dot, x_dot, u, p)
    for piece in range(EVENT_LIMIT):
        theta_1, theta_dot_1, x_1, x_dot_1, x_ddot, normal = runge_kutta(
            theta, theta_dot, x, x_dot, slip, u, p, remaining
        )
        if slip == 0.0:
            before = stick_margin(theta, theta_dot, u, p)[0]
            slope = stick_margin_rate(theta, theta_dot, u, p)
            after = stick_margin(theta_1, theta_dot_1, u, p)[0]
        else:
            before, slope, after = slip * x_dot, slip * x_ddot, slip * x_dot_1
        tau = remaining
        # The tangent bounds a convex event function from below: no dip inside the step can escape the second test.
        crossed = after < 0.0 or (before > 0.0 and before + remaining * slope < 0.0)
        # The last piece takes what is left of the step, so that no time is lost.
        crossed = crossed and piece < EVENT_LIMIT - 1
        if crossed:
            tau = _event_time(theta, theta_dot, x, x_dot, slip, u, p, before, slope, after, remaining)
            if tau < remaining:
                theta_1, theta_dot_1, x_1, x_dot_1, _, _ = runge_kutta(theta, theta_dot, x, x_dot, slip, u, p, tau)
        ended = tau < remaining or (crossed and after < 0.0)
        smallest_normal = min(smallest_normal, normal)
        swept += _swept(theta_dot, theta_dot_1, theta_1 - theta, tau)
        forward += max(0.0, x_1 - x)
        backward += max(0.0, x - x_1)
        if slip == 0.0:
            stuck += tau
        theta, theta_dot, x, x_dot = theta_1, theta_dot_1, x_1, x_dot_1
        remaining -= tau
        if not ended:
            break
        events += 1
        if slip == 0.0:
            # At the boundary rounding could read either phase from the state: the load's direction is what counts.
            slip = 1.0 if stick_margin(theta, theta_dot, u, p)[1] > 0.0 else -1.0
        else:
            x_dot = 0.0
            # Load and limit equal up to rounding: a slip that stops where it started would start again for ever.
            void = before <= 0.0 and tau <= VOID_PHASE * h
            slip = 0.0 if void else contact_phase(theta, theta_dot, x_dot, u, p)
        if remaining <= 0.0:
            break
    return Motion(theta, theta_dot, x, x_dot, forward, backward, stuck, swept, smallest_normal, events)
