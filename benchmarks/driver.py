"""Compiled loops around `dynamics.step`, so that long runs take no time in the tests and the error benchmark.

Nothing here is cached on disk: numba's cache does not notice edits in the modules it compiles from.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from benchmarks import reference
from capsule_gym import dynamics
from capsule_gym.parameters import Plant

step = njit(dynamics.step)
rates = njit(reference.rates)


class Run(NamedTuple):
    """States at every multiple of the hold (rows), and the step's own integrals added up to there (rows).

    Attributes:
        states: theta, theta_dot, x, x_dot.
        sums: forward, backward, stuck, swept.
        normal: the smallest `Motion.normal_force` of each hold, row i for the hold that ends there.
        events: number of events so far.
        most_events: the most events in any one step.
    """

    states: np.ndarray
    sums: np.ndarray
    normal: np.ndarray
    events: np.ndarray
    most_events: int


@njit
def run(torques: np.ndarray, state: tuple, p: Plant, hold: float, steps: int) -> Run:
    """Steps the plant through `torques`, each held for `hold` seconds in `steps` equal steps."""
    n = torques.size
    states, sums = np.empty((n + 1, 4)), np.zeros((n + 1, 4))
    normal, events = np.full(n + 1, math.inf), np.zeros(n + 1, dtype=np.int64)
    theta, theta_dot, x, x_dot = state
    states[0] = state
    h = hold / steps
    most_events = 0
    for i in range(n):
        sums[i + 1], events[i + 1] = sums[i], events[i]
        for _ in range(steps):
            motion = step(theta, theta_dot, x, x_dot, torques[i], p, h)
            theta, theta_dot, x, x_dot = motion.theta, motion.theta_dot, motion.x, motion.x_dot
            sums[i + 1, 0] += motion.forward
            sums[i + 1, 1] += motion.backward
            sums[i + 1, 2] += motion.stuck
            sums[i + 1, 3] += motion.swept
            normal[i + 1] = min(normal[i + 1], motion.normal_force)
            events[i + 1] += motion.events
            most_events = max(most_events, motion.events)
        states[i + 1] = (theta, theta_dot, x, x_dot)
    return Run(states, sums, normal, events, most_events)


@njit
def _losses(state: tuple, slip: float, u: float, p: Plant, c: reference.Constants) -> tuple[float, float, float]:
    """Power of the damper, power of friction and friction force, from the independently typed equations."""
    theta, theta_dot, _, x_dot = state
    alpha, _, normal = rates(theta, theta_dot, slip, u, c)
    if slip == 0.0:
        # At rest friction is what holds the platform: row two of Eq. (1) with x'' = 0.
        force = p.m * p.l * (math.cos(theta) * alpha - math.sin(theta) * theta_dot**2)
    else:
        force = slip * (p.mu if slip > 0.0 else p.mu * p.backward_ratio) * normal
    return p.c * theta_dot**2, force * x_dot, force


@njit
def audit(
    torques: np.ndarray, state: tuple, p: Plant, c: reference.Constants, hold: float, steps: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Runs the plant in steps of hold / steps and integrates what enters and leaves it along the way.

    The run goes on from the full steps alone. Each is only taken again in fine pieces for the quadrature, cut at the
    events by bisection, so that Simpson's rule always meets smooth functions.

    Returns:
        Final state; sums of work of the torque, damper loss, friction loss, friction impulse, absolute work and
        absolute friction impulse; number of events.
    """
    sums = np.zeros(6)
    theta, theta_dot, x, x_dot = state
    h = hold / steps
    events = 0
    for u in torques:
        for _ in range(steps):
            motion = step(theta, theta_dot, x, x_dot, u, p, h)
            events += motion.events
            t, piece = 0.0, 0.25 * h
            a = (theta, theta_dot, x, x_dot)
            while t < h:
                piece = min(piece, h - t)
                fine = step(a[0], a[1], a[2], a[3], u, p, piece)
                if fine.events > 0 and piece > 1e-13:
                    piece *= 0.5
                    continue
                middle = step(a[0], a[1], a[2], a[3], u, p, 0.5 * piece)
                b = (fine.theta, fine.theta_dot, fine.x, fine.x_dot)
                half = (middle.theta, middle.theta_dot, middle.x, middle.x_dot)
                slip = np.sign(half[3])
                starts, middles = _losses(a, slip, u, p, c), _losses(half, slip, u, p, c)
                ends = _losses(b, slip, u, p, c)
                for j in range(3):
                    sums[1 + j] += piece / 6.0 * (starts[j] + 4.0 * middles[j] + ends[j])
                sums[5] += piece * abs(middles[2])
                t += piece
                piece = min(2.0 * piece, 0.25 * h)
                a = b
            sums[0] += u * (motion.theta - theta)
            sums[4] += abs(u * (motion.theta - theta))
            theta, theta_dot, x, x_dot = motion.theta, motion.theta_dot, motion.x, motion.x_dot
    return np.array((theta, theta_dot, x, x_dot)), sums, events


@njit
def torque_for_load(ratio: float, theta: float, theta_dot: float, p: Plant) -> float:
    """The torque at which the load on a platform at rest is `ratio` times mu N (negative: backwards).

    Row two of Eq. (1) with x'' = 0 gives theta'', row one then the torque; mu is the coefficient forwards.
    """
    s, c = math.sin(theta), math.cos(theta)
    rough = ratio * p.mu
    wanted = rough * ((p.M + p.m) * p.g / (p.m * p.l) - theta_dot**2 * c) + theta_dot**2 * s
    alpha = wanted / (c + rough * s)
    return p.m * p.l**2 * alpha - p.m * p.g * p.l * s + p.k * theta + p.c * theta_dot


@njit
def hold_load(ratio: float, state: tuple, p: Plant, h: float, n: int) -> tuple[np.ndarray, int, np.ndarray]:
    """Holds the load at `ratio` of the limit for n steps, its sign such that the pendulum stays near -0.6 rad.

    Returns:
        Final state; number of steps at whose end the platform moved or had moved; lowest and highest angle.
    """
    theta, theta_dot, x, x_dot = state
    moved = 0
    angles = np.array((theta, theta))
    for _ in range(n):
        sign = -1.0 if theta + 0.6 + 0.5 * theta_dot > 0.0 else 1.0
        u = torque_for_load(sign * ratio, theta, theta_dot, p)
        motion = step(theta, theta_dot, x, x_dot, u, p, h)
        theta, theta_dot, x, x_dot = motion.theta, motion.theta_dot, motion.x, motion.x_dot
        if x_dot != 0.0 or x != state[2]:
            moved += 1
        angles[0], angles[1] = min(angles[0], theta), max(angles[1], theta)
    return np.array((theta, theta_dot, x, x_dot)), moved, angles
