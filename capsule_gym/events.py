"""Substeps with an event, compiled: the platform sticks or slips, or the episode ends.

`kernels.step_smooth` marks the environments. Most of them come to rest once and move on: their substep is vectorised,
the other environments are stepped one by one. Both ways give the same bits.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from capsule_gym import contact, dynamics, task
from capsule_gym.compilation import inlined, jitable, stay_apart
from capsule_gym.layout import (
    AT,
    ENDING,
    EVENT_PLANTS,
    EVENT_ROWS,
    EVENTS,
    LANES,
    PLANT_ROWS,
    VECTOR,
    Event,
    load,
    plant_of,
    store,
)
from capsule_gym.parameters import VARIED, Plant

# `task` itself does not import the compiler.
for _function in (task.termination, task.continues, task.bounded):
    inlined(_function)

# As a plain integer, which numba takes for a constant.
DIVERGED = int(task.Termination.diverged)


@inlined
def handle_events(block: np.ndarray, n: int, plant: Plant, h: float, elapsed: float) -> int:
    """Steps the marked environments through a substep.

    Args:
        block: one block of `world`; changed.
        n: environments in it.
        plant: the constants that their plants share.
        h: length of the substep, s.
        elapsed: time under the present torque at its end, s.

    Returns:
        The change of the number of environments that stick.
    """
    if n == 1:
        return step_with_events(block, 0, plant, h, elapsed) if block[AT.eventful] != 0.0 else 0
    count = 0
    for j in range(n):
        block[EVENTS + count] = j
        count += block[AT.eventful + j] != 0.0
    sticking = pass_events(block, count, plant, h) if count > 1 else 0
    for e in range(count):
        j = max(0, int(block[EVENTS + e]))
        if block[AT.eventful + j] != 0.0:
            sticking += step_with_events(block, j, plant, h, elapsed)
    return sticking


@partial(jitable, forceinline=False)
def pass_events(block: np.ndarray, count: int, plant: Plant, h: float) -> int:
    """Steps the environments that come to rest once in a substep, and unmarks them.

    The first row of EVENTS holds their places in the block. The other arguments are those of `handle_events`.

    Returns:
        The number of them that stick afterwards.
    """
    # Inlined, it would use the registers of the loops for a single environment.
    stay_apart()
    for e in range(count):
        # An index that may be negative costs a comparison at every access.
        j = max(0, int(block[EVENTS + e]))
        state, end = load(block, AT.theta + j, LANES, 4), load(block, AT.next_theta + j, LANES, 8)
        acting = block[AT.slip + j], block[AT.torque + j]
        own = block[AT.M + j], block[AT.mu + j], block[AT.mass_ratio + j]
        store(block, EVENTS + e, LANES, (float(j), *state, *acting, *own, *end))
        if plant.extended >= VARIED:
            store(block, EVENT_PLANTS + e, LANES, load(block, AT.m + j, LANES, PLANT_ROWS))
    # Whole vectors: lanes behind the last environment are computed and ignored.
    for e in range((count + VECTOR - 1) // VECTOR * VECTOR):
        event = Event(*load(block, EVENTS + e, LANES, EVENT_ROWS))
        p = Plant(event.M, event.mu, event.mass_ratio, *plant[3:])
        if plant.extended >= VARIED:
            p = Plant(*p[:5], *load(block, EVENT_PLANTS + e, LANES, PLANT_ROWS))
        start = contact.Phase(*event[1:7], p, event.theta_ddot, event.x_ddot, event.first_normal_force)
        end = event.next_theta, event.next_theta_dot, event.next_x_dot
        motion, slip, holds = contact.pass_rest(start, *end, h)
        holds &= task.continues(motion.theta, motion.normal_force) & task.bounded(motion.theta_dot, motion.x_dot)
        holds &= (abs(motion.x + motion.swept) < math.inf) & (event.least_normal_force >= 0.0)
        store(block, EVENTS + e, LANES, (event.place, 1.0 if holds else 0.0, slip, *motion[:9], 1.0))
    sticking = 0
    for e in range(count):
        result = load(block, EVENTS + e, LANES, 13)
        if result[1] != 0.0:
            j, slip = max(0, int(result[0])), result[2]
            block[AT.eventful + j], block[AT.slip + j] = 0.0, slip
            sticking += slip == 0.0
            add_motion(block, j, contact.Motion(*result[3:]))
    return sticking


@inlined
def add_motion(block: np.ndarray, j: int, motion: contact.Motion) -> None:
    """Writes the state at the end of a substep, and adds its contributions to the step and to the episode."""
    store(block, AT.theta + j, LANES, motion[:4])
    block[AT.energy + j] += abs(block[AT.torque + j]) * motion.swept
    block[AT.forward + j] += motion.forward
    block[AT.backward + j] += motion.backward
    block[AT.stuck + j] += motion.stuck
    block[AT.normal_force + j] = min(block[AT.normal_force + j], motion.normal_force)
    block[AT.largest_theta + j] = max(block[AT.largest_theta + j], abs(motion.theta))
    block[AT.largest_theta_dot + j] = max(block[AT.largest_theta_dot + j], abs(motion.theta_dot))


@jitable
def step_with_events(block: np.ndarray, j: int, plant: Plant, h: float, elapsed: float) -> int:
    """Steps one environment through a substep with an event; returns the change of the number that sticks."""
    p = plant_of(block, j, plant)
    torque = block[AT.torque + j]
    theta, theta_dot, x, x_dot = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x + j], block[AT.x_dot + j]
    slip = block[AT.slip + j]
    first = load(block, AT.theta_ddot + j, LANES, 3)
    start = contact.Phase(theta, theta_dot, x, x_dot, slip, torque, p, *first)
    if block[AT.least_normal_force + j] >= 0.0:
        whole = contact.finish(start, h, *load(block, AT.next_theta + j, LANES, 4), first[1], first[2])
    else:
        whole = contact.piece(start, h)
    motion = contact.event_step(start, whole)
    whole_motion = motion.theta + motion.x + motion.swept + motion.normal_force
    if not (task.bounded(motion.theta_dot, motion.x_dot) and math.isfinite(whole_motion)):
        # The substep is discarded: the environment keeps the state at its start.
        normal = dynamics.accelerations(theta, theta_dot, x_dot, slip, torque, p)[2]
        block[AT.normal_force + j] = min(block[AT.normal_force + j], normal)
        block[AT.termination + j] = DIVERGED
        block[AT.halt + j] = ENDING
        block[AT.elapsed + j] = elapsed - h
        block[AT.slip + j] = 1.0
        return -1 if slip == 0.0 else 0
    add_motion(block, j, motion)
    ended = task.termination(motion.theta, motion.normal_force)
    next_slip = dynamics.contact_phase(motion.theta, motion.theta_dot, motion.x_dot, torque, p)
    if ended != 0:
        block[AT.termination + j] = ended
        block[AT.halt + j] = ENDING
        block[AT.elapsed + j] = elapsed
        next_slip = 1.0
    block[AT.slip + j] = next_slip
    return (1 if next_slip == 0.0 else 0) - (1 if slip == 0.0 else 0)
