"""The physics, once: plain scalar functions of SI quantities that numba compiles for every use.

The plant is the paper's Eq. (1), its misprints corrected (docs/physics.md names them), with q = [theta, x] and the
friction force f:

    m l^2 theta'' - m l cos(theta) x'' - m g l sin(theta) + k theta + c theta' = u
    (M + m) x'' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = 0

Within a phase of contact the motion is smooth. `slip` names the phase: +1.0 forwards, -1.0 backwards, 0.0 stick.
The phase follows from the state alone: the platform sticks only where x_dot is exactly 0.0.

That is the plant on a level floor with Coulomb friction alone. Where `Plant.extended` is not 0.0, a constant of the
compiler's, the floor may slope (g is then g cos(slope), and a = g sin(slope)), its friction may depend on the speed (b
is the viscous coefficient, v_s the speed of the Stribeck curve), the motor may have friction u_f, and a force F may
push the platform. The equations become

    m l^2 theta'' - m l cos(theta) x'' - m l (g sin(theta) + a cos(theta)) + k theta + c theta'
        = u - u_f (35 s - 35 s^3 + 21 s^5 - 5 s^7) / 16
    (M + m) (x'' + a) + b x' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = F

with f = d mu (1 + (static_ratio - 1) / (1 + (x' / v_s)^2)) N in slip in the direction d, and s = theta' / w, clipped to
[-1, 1].

Every function is ordinary Python; `jitable` lets compiled code call it too. What a step does inside one phase is free
of branches, so that compilers take several environments through it at once (`smooth_step`), and so is the commonest
change of phase (`pass_rest`); `step` takes one environment through every change of phase. `fma(a, b, c)` is a b + c.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from capsule_gym.compilation import inlined, jitable
from capsule_gym.elementary import clip, fma, sincos
from capsule_gym.parameters import LEVEL, MOTOR_SLOPE, MOTOR_WIDTH, Plant

# No step holds anywhere near as many events. The cap only keeps a rounding accident from hanging compiled code.
EVENT_LIMIT = 1000
# Size of the boundary (m/s in slip, N in stick) that counts as zero: ten times its rounding error.
EVENT_TOLERANCE = 1e-15
ROOT_ITERATIONS = 60
CUBIC_ITERATIONS = 3
# Share of a step that the state may be moved along its tangent: at 2 ms and 50 rad/s^2 an error of 1e-16 rad.
LAST_CORRECTION = 1e-6
# Share of a bracket below which its halves are the same number.
SMALLEST_BRACKET = 1e-14
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


@inlined
def kinetic_friction(slip: float, p: Plant) -> float:
    """Friction coefficient while sliding fast in the direction of `slip` (+1.0 or -1.0)."""
    return p.mu * p.backward_ratio if slip < 0.0 else p.mu


@inlined
def stribeck(x_dot: float, p: Plant) -> float:
    """Friction coefficient at a velocity over the one at high speed: the Stribeck curve of Hess and Soom (1990)."""
    ratio = x_dot * p.stribeck_rate
    return 1.0 + p.stribeck_excess / (1.0 + ratio * ratio)


@inlined
def normal_force(theta: float, theta_dot: float, theta_ddot: float, p: Plant) -> float:
    """Force of the floor on the platform in N, before the clamp at zero: Newton's law on the vertical.

    With the paper's option the pivot's torque is subtracted as (7) prints it.
    """
    sin, cos = sincos(theta)
    newton = (p.M + p.m) * p.g - p.m * p.l * (theta_ddot * sin + theta_dot * theta_dot * cos)
    if p.pivot_torque_on_contact != 0.0:
        return newton - p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin  # Eq. (7)
    return newton


@inlined
def driving_force(theta: float, theta_dot: float, theta_ddot: float, p: Plant) -> float:
    """Horizontal force in N with which the pendulum pushes a platform that does not accelerate; friction opposes it."""
    sin, cos = sincos(theta)
    force = p.m * p.l * (cos * theta_ddot - sin * theta_dot * theta_dot)
    if 0.0 < p.extended < LEVEL:
        force += p.push - (p.M + p.m) * p.downhill
    return force


@inlined
def motor_friction(theta_dot: float, p: Plant) -> float:
    """Torque in N m with which the motor's own friction opposes its motion: from MOTOR_WIDTH on Coulomb's.

    Three times continuously differentiable, which leaves the integrator its order, without a root or a division.
    """
    ratio = theta_dot * (1.0 / MOTOR_WIDTH)
    z = min(ratio * ratio, 1.0)
    steep = fma(z * z, fma(-0.3125, z, 1.3125), fma(-MOTOR_SLOPE, z, MOTOR_SLOPE))
    return p.motor_friction * clip(ratio, 1.0) * steep


@inlined
def stick_acceleration(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """theta'' in rad/s^2 on a platform at rest: the first row of Eq. (1) with x'' = 0."""
    inertia = p.m * p.l * p.l
    sin, cos = sincos(theta)
    if p.extended == LEVEL:
        u -= motor_friction(theta_dot, p)
    elif p.extended != 0.0:
        u += p.m * p.l * p.downhill * cos - motor_friction(theta_dot, p)
    free = fma(-(p.k / inertia), theta, fma(-(p.c / inertia), theta_dot, u * (1.0 / inertia)))
    return fma(p.g / p.l, sin, free)


@inlined
def pressed_accelerations(
    theta: float, theta_dot: float, x_dot: float, slip: float, mu: float, u: float, p: Plant
) -> tuple[float, float, float]:
    """theta'', x'' and N of Eq. (1) with f = slip mu N, one formula for slip and stick (slip = 0 pins x'' = 0).

    N comes out as it is, also below zero.
    """
    sin, cos = sincos(theta)
    share = slip * slip * p.mass_ratio
    rough = slip * mu
    # Most floors have no such curve: a division less.
    if 0.0 < p.extended < LEVEL and p.stribeck_excess != 0.0:
        rough *= stribeck(x_dot, p)
    squared = theta_dot * theta_dot
    weight = (p.M + p.m) * p.g
    brake = rough * p.g
    if p.pivot_torque_on_contact != 0.0:
        pivot = p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin  # Eq. (7)
        weight -= pivot
        brake -= rough * pivot / (p.M + p.m)
    if 0.0 < p.extended < LEVEL:
        brake += slip * slip * (p.downhill + (p.viscous * x_dot - p.push) / (p.M + p.m))
    # The second row over M + m: x'' = rest + share l tilted theta''. N holds theta'' too, hence cos + slip mu sin.
    tilted = fma(rough, sin, cos)
    rest = fma(share * p.l, fma(rough, cos, -sin) * squared, -brake)
    # The first row over m l^2: theta'' = free + cos x'' / l.
    free = stick_acceleration(theta, theta_dot, u, p)
    # The division need not wait for what it divides.
    theta_ddot = fma(cos * (1.0 / p.l), rest, free) * (1.0 / fma(-share * cos, tilted, 1.0))
    x_ddot = fma(share * p.l * tilted, theta_ddot, rest)
    return theta_ddot, x_ddot, fma(-(p.m * p.l), fma(squared, cos, theta_ddot * sin), weight)


@jitable
def accelerations(
    theta: float, theta_dot: float, x_dot: float, slip: float, u: float, p: Plant
) -> tuple[float, float, float]:
    """theta'' in rad/s^2, x'' in m/s^2 and the normal force in N, clamped at zero: a floor does not pull.

    Args:
        theta: angle, rad.
        theta_dot: its rate, rad/s.
        x_dot: velocity of the platform, m/s.
        slip: phase of the contact, +1.0, -1.0 or 0.0 (stick).
        u: motor torque, N m.
        p: the plant.
    """
    mu = kinetic_friction(slip, p)
    theta_ddot, x_ddot, normal = pressed_accelerations(theta, theta_dot, x_dot, slip, mu, u, p)
    if normal < 0.0:
        theta_ddot, x_ddot, normal = pressed_accelerations(theta, theta_dot, x_dot, slip, 0.0, u, p)
        normal = 0.0
    return theta_ddot, x_ddot, normal


@inlined
def stick_margin(theta: float, theta_dot: float, u: float, p: Plant) -> tuple[float, float]:
    """Static friction limit minus |driving force|, in N, and the driving force itself: it sticks while >= 0."""
    theta_ddot = stick_acceleration(theta, theta_dot, u, p)
    force = driving_force(theta, theta_dot, theta_ddot, p)
    limit = p.static_ratio * kinetic_friction(force, p) * max(0.0, normal_force(theta, theta_dot, theta_ddot, p))
    return limit - abs(force), force


@inlined
def phase_at_rest(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """The phase of the contact at rest: 0.0 below the static limit, else the load's direction."""
    margin, force = stick_margin(theta, theta_dot, u, p)
    return 0.0 if margin >= 0.0 else 1.0 if force > 0.0 else -1.0


@inlined
def contact_phase(theta: float, theta_dot: float, x_dot: float, u: float, p: Plant) -> float:
    """The phase of the contact: the direction of motion, or `phase_at_rest`."""
    if x_dot > 0.0:
        return 1.0
    if x_dot < 0.0:
        return -1.0
    return phase_at_rest(theta, theta_dot, u, p)


@inlined
def stick_margin_rate(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """Time derivative of `stick_margin` in N/s along a stick phase, at constant torque."""
    sin, cos = sincos(theta)
    ml = p.m * p.l
    a = stick_acceleration(theta, theta_dot, u, p)
    torque_rate = ml * p.g * cos * theta_dot - p.k * theta_dot - p.c * a
    if p.extended != 0.0:
        s = clip(theta_dot * (1.0 / MOTOR_WIDTH), 1.0)
        left = 1.0 - s * s
        slope = p.motor_friction * (MOTOR_SLOPE / MOTOR_WIDTH) * (left * left * left)
        torque_rate -= ml * p.downhill * sin * theta_dot + slope * a
    jerk = torque_rate / (ml * p.l)
    force = driving_force(theta, theta_dot, a, p)
    force_rate = ml * (cos * jerk - 3.0 * sin * theta_dot * a - cos * theta_dot * theta_dot * theta_dot)
    normal_rate = -ml * (sin * jerk + 3.0 * cos * theta_dot * a - sin * theta_dot * theta_dot * theta_dot)
    if p.pivot_torque_on_contact != 0.0:
        pivot_rate = (p.k * theta_dot + p.c * a) * sin + (p.k * theta + p.c * theta_dot) * cos * theta_dot
        normal_rate -= p.pivot_torque_on_contact * pivot_rate
    limit_rate = p.static_ratio * kinetic_friction(force, p) * normal_rate
    return limit_rate - force_rate if force > 0.0 else limit_rate + force_rate


@inlined
def runge_kutta(
    theta: float,
    theta_dot: float,
    x: float,
    x_dot: float,
    slip: float,
    mu: float,
    u: float,
    p: Plant,
    h: float,
    first: tuple[float, float, float],
) -> tuple[float, float, float, float, float]:
    """One classical Runge-Kutta step of h seconds inside one phase, with the friction coefficient mu.

    `first` is `pressed_accelerations` at the start.

    Returns:
        The state afterwards, and the smallest N of the stages: where that is negative, the step was none of a platform
        that presses on the floor.
    """
    # The accelerations do not depend on x, nor on a level floor of Coulomb's friction on x_dot: sums are enough.
    half = 0.5 * h
    theta_2 = theta + half * theta_dot
    a1, b1, normal_1 = first
    a2, b2, normal_2 = pressed_accelerations(theta_2, theta_dot + half * a1, x_dot + half * b1, slip, mu, u, p)
    theta_3, theta_dot_3 = theta_2 + half * half * a1, theta_dot + half * a2
    a3, b3, normal_3 = pressed_accelerations(theta_3, theta_dot_3, x_dot + half * b2, slip, mu, u, p)
    theta_4 = theta + h * theta_dot + half * h * a2
    a4, b4, normal_4 = pressed_accelerations(theta_4, theta_dot + h * a3, x_dot + h * b3, slip, mu, u, p)
    sixth = h / 6.0
    return (
        theta + h * theta_dot + h * sixth * (a1 + a2 + a3),
        theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        x + h * x_dot + h * sixth * (b1 + b2 + b3),
        x_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4),
        min(min(normal_1, normal_2), min(normal_3, normal_4)),
    )


@inlined
def boundary(
    theta: float, theta_dot: float, x_dot: float, x_ddot: float, slip: float, u: float, p: Plant
) -> tuple[float, float]:
    """What must stay positive for the phase to last, and its time derivative: m/s in slip, N in stick."""
    if slip == 0.0:
        return stick_margin(theta, theta_dot, u, p)[0], stick_margin_rate(theta, theta_dot, u, p)
    return slip * x_dot, slip * x_ddot


@inlined
def crosses(before: float, rate: float, after: float, h: float) -> bool:
    """Whether the boundary may have been crossed within h seconds.

    The tangent bounds a convex function from below: no dip inside the step can escape the second test.
    """
    return after < 0.0 or (before > 0.0 and before + h * rate < 0.0)


@inlined
def smooth_step(
    theta: float, theta_dot: float, x: float, x_dot: float, slip: float, u: float, p: Plant, h: float, may_stick: bool
) -> tuple[float, float, float, float, float, float, float, float, bool]:
    """`step` where nothing happens: h seconds inside one phase, free of branches.

    Args:
        theta: angle from the upright, rad.
        theta_dot: its rate, rad/s.
        x: displacement of the platform, m.
        x_dot: its velocity, m/s.
        slip: the phase.
        u: motor torque, N m.
        p: the plant.
        h: length of the step, s.
        may_stick: False promises that slip is not 0.0; where the compiler knows it, that saves a third of the work.

    Returns:
        The state afterwards; theta'', x'' and N at the start; the smallest N of the stages; and whether the phase
        lasts: if not, only `event_step` knows what happens.
    """
    mu = kinetic_friction(slip, p)
    theta_ddot, x_ddot, normal = first = pressed_accelerations(theta, theta_dot, x_dot, slip, mu, u, p)
    theta_1, theta_dot_1, x_1, x_dot_1, smallest = runge_kutta(theta, theta_dot, x, x_dot, slip, mu, u, p, h, first)
    if may_stick:
        before, rate = boundary(theta, theta_dot, x_dot, x_ddot, slip, u, p)
        after = boundary(theta_1, theta_dot_1, x_dot_1, x_ddot, slip, u, p)[0]
        stopped = x_dot_1 == 0.0 and slip != 0.0
    else:
        before, rate, after = slip * x_dot, slip * x_ddot, slip * x_dot_1
        stopped = x_dot_1 == 0.0
    lasts = not (crosses(before, rate, after, h) or stopped or smallest < 0.0)
    return theta_1, theta_dot_1, x_1, x_dot_1, theta_ddot, x_ddot, normal, smallest, lasts


class Phase(NamedTuple):
    """The start of a phase of contact: state, slip (+1.0, -1.0, or 0.0 for stick), motor torque, plant, accelerations.

    theta'', x'' and N are those of `pressed_accelerations`.
    """

    theta: float
    theta_dot: float
    x: float
    x_dot: float
    slip: float
    u: float
    p: Plant
    theta_ddot: float
    x_ddot: float
    normal_force: float


class Piece(NamedTuple):
    """A part of a step that stays in one phase: its length tau in s, and the state at its end.

    `boundary` must be positive for the phase to last. x'' and N are also kept as they are at the start.
    """

    tau: float
    theta: float
    theta_dot: float
    x: float
    x_dot: float
    boundary: float
    boundary_rate: float
    theta_ddot: float
    x_ddot: float
    first_x_ddot: float
    normal_force: float


@jitable
def begin(theta: float, theta_dot: float, x: float, x_dot: float, slip: float, u: float, p: Plant) -> Phase:
    """The phase that starts in this state."""
    first = pressed_accelerations(theta, theta_dot, x_dot, slip, kinetic_friction(slip, p), u, p)
    return Phase(theta, theta_dot, x, x_dot, slip, u, p, *first)


@jitable
def finish(
    start: Phase, tau: float, theta: float, theta_dot: float, x: float, x_dot: float, x_ddot: float, normal: float
) -> Piece:
    """The piece of tau seconds that has led from a start to this state; x_ddot and normal are those at its start."""
    slip, u, p = start.slip, start.u, start.p
    theta_ddot, last_x_ddot, _ = accelerations(theta, theta_dot, x_dot, slip, u, p)
    value, rate = boundary(theta, theta_dot, x_dot, last_x_ddot, slip, u, p)
    return Piece(tau, theta, theta_dot, x, x_dot, value, rate, theta_ddot, last_x_ddot, x_ddot, max(0.0, normal))


@jitable
def piece(start: Phase, tau: float) -> Piece:
    """tau seconds in one phase, whether it lasts or not.

    Always a full Runge-Kutta step from the phase's start, so that an event is as accurate as the integrator itself. A
    step in which the contact is lost is one without friction.
    """
    theta, theta_dot, x, x_dot, slip, u, p = start[:7]
    mu, first = kinetic_friction(slip, p), start[7:]
    for _ in range(2):
        theta_1, theta_dot_1, x_1, x_dot_1, smallest = runge_kutta(
            theta, theta_dot, x, x_dot, slip, mu, u, p, tau, first
        )
        if smallest >= 0.0:
            break
        mu = 0.0
        first = pressed_accelerations(theta, theta_dot, x_dot, slip, mu, u, p)
    return finish(start, tau, theta_1, theta_dot_1, x_1, x_dot_1, first[1], first[2])


@jitable
def _dip(before: float, rate: float, after: float, h: float) -> float:
    """Where the parabola with that start, rate and end has its minimum in (0, h); h where it has none."""
    curvature = after - before - rate * h
    if curvature <= 0.0:
        return h
    return min(h, -0.5 * rate * h * h / curvature)


@inlined
def _first_guess(g_low: float, rate_low: float, g_high: float, rate_high: float, width: float) -> float:
    """Root in (0, width) of the cubic with those values and rates at its ends, the first positive, the last not."""
    # In s = tau / width: g_low + c s + d s^2 + e s^3.
    c = rate_low * width
    end = rate_high * width
    d = 3.0 * (g_high - g_low) - 2.0 * c - end
    e = 2.0 * (g_low - g_high) + c + end
    s = g_low / (g_low - g_high)
    for _ in range(CUBIC_ITERATIONS):
        value = fma(fma(fma(e, s, d), s, c), s, g_low)
        slope = fma(fma(3.0 * e, s, 2.0 * d), s, c)
        s = min(1.0, max(0.0, s - value / slope)) if slope < 0.0 else s
    return s * width


@jitable
def _shifted(end: Piece, correction: float) -> Piece:
    """The piece, longer by a time so small that its end follows the tangent, to where the boundary is met."""
    return Piece(
        end.tau + correction,
        end.theta + correction * end.theta_dot,
        end.theta_dot + correction * end.theta_ddot,
        end.x + correction * end.x_dot,
        end.x_dot + correction * end.x_ddot,
        0.0,
        end.boundary_rate,
        end.theta_ddot,
        end.x_ddot,
        end.first_x_ddot,
        end.normal_force,
    )


@jitable
def _root(start: Phase, low: float, before: float, rate: float, beyond: Piece) -> Piece:
    """The piece that ends on the boundary: Newton's method on re-taken steps, kept inside a bracket.

    The cubic through the bracket's ends lets it start close to the root. The last correction is so small that the state
    follows it in a straight line. The bracket begins at `low`, with the boundary `before` > 0 and its rate there.
    """
    width, end = beyond.tau - low, beyond.tau
    tau = low + _first_guess(before, rate, beyond.boundary, beyond.boundary_rate, width)
    correction = math.inf
    for _ in range(ROOT_ITERATIONS):
        trial = piece(start, tau)
        correction = -trial.boundary / trial.boundary_rate if trial.boundary_rate < 0.0 else math.inf
        small = abs(correction) <= LAST_CORRECTION * width
        if small or abs(trial.boundary) <= EVENT_TOLERANCE or end - low <= SMALLEST_BRACKET * width:
            break
        if trial.boundary < 0.0:
            end = tau
        else:
            low = tau
        tau += correction
        if not low < tau < end:
            tau = 0.5 * (low + end)
    return trial if abs(correction) > LAST_CORRECTION * width else _shifted(trial, correction)


@jitable
def _until_event(start: Phase, before: float, rate: float, whole: Piece) -> Piece:
    """The piece up to the first event of a step that may have crossed the phase's boundary; `whole` where none has."""
    beyond = whole
    if whole.boundary >= 0.0:
        dip = _dip(before, rate, whole.boundary, whole.tau)
        if dip >= whole.tau:
            return whole
        beyond = piece(start, dip)
        if beyond.boundary >= 0.0:
            return whole
    if before > EVENT_TOLERANCE:
        return _root(start, 0.0, before, rate, beyond)
    # A phase that starts on its own boundary: the bracket is void until that has been left.
    for _ in range(ROOT_ITERATIONS):
        left = piece(start, 0.5 * beyond.tau)
        if left.boundary > 0.0:
            return _root(start, left.tau, left.boundary, left.boundary_rate, beyond)
        beyond = left
    return beyond


@inlined
def swept(start: float, end: float, turned: float, h: float) -> float:
    """Integral of |theta_dot| over h seconds that turned the pendulum by `turned`; theta_dot went from start to end."""
    if start * end >= 0.0:
        return abs(turned)
    return 0.5 * h * (start * start + end * end) / (abs(start) + abs(end))


@jitable
def event_step(start: Phase, whole: Piece) -> Motion:
    """`step` from a phase and from what the whole step would be if that phase lasted."""
    theta, theta_dot, x, x_dot, slip, u, p = start[:7]
    forward = backward = stuck = turned = 0.0
    smallest_normal = math.inf
    events = 0
    h = whole.tau
    remaining = h
    phase, done = start, whole
    for count in range(EVENT_LIMIT):
        if count > 0:
            phase = begin(theta, theta_dot, x, x_dot, slip, u, p)
            done = piece(phase, remaining)
        before, rate = boundary(theta, theta_dot, x_dot, done.first_x_ddot, slip, u, p)
        # The last piece takes what is left of the step, so that no time is lost.
        crossed = crosses(before, rate, done.boundary, remaining) and count < EVENT_LIMIT - 1
        beyond = crossed and done.boundary < 0.0
        if crossed:
            done = _until_event(phase, before, rate, done)
        tau = done.tau
        ended = tau < remaining or beyond
        smallest_normal = min(smallest_normal, done.normal_force)
        turned += swept(theta_dot, done.theta_dot, done.theta - theta, tau)
        forward += max(0.0, done.x - x)
        backward += max(0.0, x - done.x)
        if slip == 0.0:
            stuck += tau
        theta, theta_dot, x, x_dot = done.theta, done.theta_dot, done.x, done.x_dot
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
    return Motion(theta, theta_dot, x, x_dot, forward, backward, stuck, turned, smallest_normal, events)


@inlined
def pass_rest(start: Phase, theta_1: float, theta_dot_1: float, x_dot_1: float, h: float) -> tuple[Motion, float, bool]:
    """`event_step` from slip through one moment of rest, free of branches, with the same bits.

    Args:
        start: the phase.
        theta_1: the angle after h seconds if the phase lasted, rad.
        theta_dot_1: its rate, rad/s.
        x_dot_1: the platform's velocity, m/s.
        h: length of the step, s.

    Returns:
        What `event_step` returns, the last phase, and whether that holds: if not, something else happens, or the moment
        takes more than one trial to find.
    """
    theta, theta_dot, x, x_dot, slip, u, p, _, x_ddot, normal = start
    mu = kinetic_friction(slip, p)
    before, after = slip * x_dot, slip * x_dot_1
    _, x_ddot_1, normal_1 = pressed_accelerations(theta_1, theta_dot_1, x_dot_1, slip, mu, u, p)
    holds = (slip != 0.0) & (before > EVENT_TOLERANCE) & (after < 0.0) & (normal_1 >= 0.0)
    tau = _first_guess(before, slip * x_ddot, after, slip * x_ddot_1, h)
    first = start[7:]
    theta_2, theta_dot_2, x_2, x_dot_2, smallest = runge_kutta(theta, theta_dot, x, x_dot, slip, mu, u, p, tau, first)
    theta_ddot_2, x_ddot_2, normal_2 = pressed_accelerations(theta_2, theta_dot_2, x_dot_2, slip, mu, u, p)
    correction = -(slip * x_dot_2) / (slip * x_ddot_2)
    holds &= (smallest >= 0.0) & (normal_2 >= 0.0) & (slip * x_ddot_2 < 0.0) & (abs(correction) <= LAST_CORRECTION * h)
    tau += correction
    theta_2, theta_dot_2 = theta_2 + correction * theta_dot_2, theta_dot_2 + correction * theta_ddot_2
    x_2 += correction * x_dot_2
    slip = phase_at_rest(theta_2, theta_dot_2, u, p)
    rest = h - tau
    theta_3, theta_dot_3, x_3, x_dot_3, _, _, normal_2, _, lasts = smooth_step(
        theta_2, theta_dot_2, x_2, 0.0, slip, u, p, rest, True
    )
    turned = swept(theta_dot, theta_dot_2, theta_2 - theta, tau)
    turned += swept(theta_dot_2, theta_dot_3, theta_3 - theta_2, rest)
    forward = max(0.0, x_2 - x) + max(0.0, x_3 - x_2)
    backward = max(0.0, x - x_2) + max(0.0, x_2 - x_3)
    stuck = rest if slip == 0.0 else 0.0
    normal = min(normal, normal_2)
    motion = Motion(theta_3, theta_dot_3, x_3, x_dot_3, forward, backward, stuck, turned, normal, 1)
    return motion, slip, holds & lasts & (rest > 0.0)


@jitable
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
    start = begin(theta, theta_dot, x, x_dot, contact_phase(theta, theta_dot, x_dot, u, p), u, p)
    return event_step(start, piece(start, h))
