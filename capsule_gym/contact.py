"""Steps of the plant through changes of the contact phase, which are located inside the step.

`step` advances one environment through every change of phase. `pass_rest` computes the most common change, the end of
a slip, without branches, so that compilers can vectorise it over environments.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from capsule_gym.compilation import inlined, jitable
from capsule_gym.dynamics import (
    accelerations,
    boundary,
    contact_phase,
    crosses,
    kinetic_friction,
    phase_at_rest,
    pressed_accelerations,
    runge_kutta,
    smooth_step,
    stick_margin,
    swept,
)
from capsule_gym.elementary import fma
from capsule_gym.parameters import Plant

# Far more events than in any step. The limit only prevents an endless loop after a rounding error.
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
    """The result of a step: the new state and the integrals over the step.

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

    The phase lasts while `boundary` is positive. `first_x_ddot` and `normal_force` are x'' and N at the start.
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
    """Takes a step of tau seconds in one phase, even if the phase would end earlier.

    The result is always a full Runge-Kutta step from the phase's start, so that an event is as accurate as the
    integrator itself. A step in which the contact is lost is taken without friction.
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
    """The location in (0, h) of the minimum of the parabola with this start, rate and end; h if there is none."""
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
    """The piece, extended to the boundary by a time so small that its end follows the tangent."""
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

    The first guess is the root of the cubic through the bracket's ends. The last correction is so small that the state
    is extrapolated linearly. The bracket begins at `low`, with the boundary `before` > 0 and its rate there.
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
    """The piece up to the first event of a step that may have crossed the boundary, or `whole` without an event."""
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
    # The phase starts on its own boundary: a bracket must begin after the state has left the boundary.
    for _ in range(ROOT_ITERATIONS):
        left = piece(start, 0.5 * beyond.tau)
        if left.boundary > 0.0:
            return _root(start, left.tau, left.boundary, left.boundary_rate, beyond)
        beyond = left
    return beyond


@jitable
def event_step(start: Phase, whole: Piece) -> Motion:
    """`step` from a phase and from the whole step under the assumption that this phase lasts."""
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
        # The last piece takes the rest of the step, so that no time is lost.
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
            # At the boundary rounding could give either phase, so the direction of the load decides.
            slip = 1.0 if stick_margin(theta, theta_dot, u, p)[1] > 0.0 else -1.0
        else:
            x_dot = 0.0
            # If load and limit are equal up to rounding, a slip that stops where it started would start again forever.
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
        The result of `event_step`, the last phase, and whether both are valid. They are not if another event happens,
        or if locating the moment takes more than one trial.
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
