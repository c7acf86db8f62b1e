"""Strokes, which move the platform to a goal on a smooth floor, by feedback linearisation of its motion.

On a smooth floor friction changes the total momentum slowly, so the law moves the centre of mass to the goal and stops
it there. In the phase `CREEP` the platform sticks, and the pendulum accelerates or brakes the centre of mass with most
of the force that friction can take. If the pendulum has reached the front, or the goal is within reach, the platform
makes a `STROKE` under the centre of mass, as far as the pendulum can swing. The centre of mass may still move on
arrival: the platform already rests while the pendulum brakes.

The numbers were chosen on 300 goals with seeds from 7000 on, on the paper's floor.
"""

from __future__ import annotations

import math

from capsule_gym.compilation import inlined
from capsule_gym.elementary import clip, sincos
from capsule_gym.parameters import NOMINAL

CREEP, STROKE = 4.0, 5.0
# Share of the friction that the pendulum uses in CREEP, and share of its largest reach, sin(theta) = 1, to which it
# swings.
GRIP, REACH = 0.85, 0.82
# Duration of a stroke, s, for the distance that the centre of mass moves in it.
STROKE_TIME = 0.22
# Accelerations of the platform, m/s^2, its largest velocity relative to the centre of mass, m/s, beyond which light
# platforms lose contact, and the rate at which it comes to rest where that is slower, 1/s.
SPEEDING_UP, SLOWING_DOWN, FASTEST, ARRIVAL = 10.0, 7.0, 0.65, 30.0
# Time constants, s: of the velocity in a stroke, of the platform's stop in CREEP, and of the stop at the end.
VELOCITY_TIME, REST_TIME, END_TIME = 0.006, 0.002, 0.005
# Error that is not corrected, m.
NEAR = 0.0018
# Largest angle of the pendulum, rad; decelerations above GUARD, rad/s^2, give priority to this limit.
OUTERMOST, GUARD = 1.25, 100.0
m, l, g, k, c = NOMINAL.m, NOMINAL.l, NOMINAL.g, NOMINAL.k, NOMINAL.c


@inlined
def held_back(theta: float, theta_dot: float, acceleration: float, grip: float) -> float:
    """The torque in N m that gives the pendulum an acceleration while the platform sticks, but keeps it from falling.

    If stopping the pendulum at OUTERMOST requires a deceleration above `grip`, rad/s^2, the stop has priority.
    """
    side = 1.0 if theta_dot > 0.0 else -1.0
    needed = theta_dot * theta_dot / (2.0 * max(0.02, OUTERMOST - side * theta))
    acceleration = -1.05 * side * needed if needed > grip else acceleration
    return k * theta + c * theta_dot - m * l * g * sincos(theta)[0] + m * l * l * acceleration


@inlined
def arriving(way: float) -> float:
    """The velocity in m/s from which the platform stops within `way` metres."""
    way = max(0.0, way)
    return min(math.sqrt(2.0 * SLOWING_DOWN * way), ARRIVAL * way)


@inlined
def stroke_torque(
    theta: float, theta_dot: float, x_dot: float, way: float, M: float, mu: float, phase: float
) -> tuple[float, float]:
    """The torque in N m and the next phase, CREEP or STROKE, for a goal that lies `way` metres ahead.

    For a goal behind the platform the state is mirrored. x_dot is exactly 0.0 in stick.
    """
    sin, cos = sincos(theta)
    weight, shift = (M + m) * g, m * l / (M + m)
    # The centre of mass, relative to the platform, and its velocity.
    centre, velocity = -shift * sin, x_dot - shift * cos * theta_dot
    reach = centre + shift * REACH
    within = way <= reach + STROKE_TIME * max(0.0, velocity)
    if phase == CREEP and way > NEAR and (within or sin <= -REACH):
        phase = STROKE
    elif phase == STROKE and (way < NEAR or (reach < NEAR and not within)):
        phase = CREEP
    normal = weight - m * l * theta_dot * theta_dot / cos
    acceleration = 0.0
    if phase == STROKE:
        wanted = min(arriving(way), velocity + arriving(reach), max(0.0, velocity) + FASTEST)
        acceleration = min(SPEEDING_UP, max(-1.5 * SLOWING_DOWN, (wanted - x_dot) / VELOCITY_TIME))
        inertial = (M + m) * acceleration
        normal = (normal - sin / cos * inertial) / (1.0 + mu * sin / cos)
        force = inertial + mu * normal * (1.0 if x_dot >= 0.0 else -1.0)
    else:
        limit = GRIP * mu * normal
        # The pendulum may swing to the front until the centre of mass is there.
        brakes = velocity * max(0.0, velocity) > 2.0 * GRIP * mu * g * max(0.0, way + shift * REACH - centre)
        force = clip((M + m) * velocity / END_TIME, limit) if way <= NEAR else limit if brakes else -mu * normal
        force -= (M + m) * x_dot / REST_TIME
    # The acceleration of the pendulum that exerts this force on the platform.
    swing = (force / (m * l) + sin * theta_dot * theta_dot) / cos
    return held_back(theta, theta_dot, swing, GUARD) - m * l * cos * acceleration, phase
