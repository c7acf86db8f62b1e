"""The physics of the plant, over arrays: functions of the core.

`capsule_gym/core/physics/plant.hpp` and `events.hpp` contain and derive the equations. The
environment's step calls `contact_phase` and `stick_margin`, which call `driving_force` and
`normal_force`. It solves Eq. (1) by the function whose normal force `accelerations` clamps. This
solution contains `driving_force` and `friction_force`, but does not call them, since both depend on
the unknown theta''; it takes the friction coefficient and Newton's normal force from the same
functions of the core. `step` has the bits of an integrator step of the environment.

Arguments are numbers or arrays, which are broadcast, also M and mu of the plant; results are
float64 arrays of the common shape. Everything is in SI units: `theta` is the angle from the upright
(rad), `theta_dot` and `theta_ddot` are its derivatives, `x_dot` is the velocity of the platform,
`u` the motor torque. `slip` names the phase of contact: +1.0 forwards, -1.0 backwards, 0.0 stick.

Examples:
    >>> from capsule_gym import Capsule, dynamics
    >>> margin, _ = dynamics.stick_margin(-1.0, 0.0, [0.2, 0.4], Capsule(mu=0.1).plant())
    >>> margin > 0.0
    array([ True, False])
"""

from typing import Any, NamedTuple

import numpy as np

from capsule_gym.checks import require
from capsule_gym.core import _core
from capsule_gym.core.native import evaluate, ordered
from capsule_gym.parameters import Plant

Numbers = Any
"""A number or an array of numbers."""


class Accelerations(NamedTuple):
    """theta'' in rad/s^2, x'' in m/s^2, and the normal force in N."""

    theta_ddot: np.ndarray
    x_ddot: np.ndarray
    normal_force: np.ndarray


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
        normal_force: the smallest normal force met at the start of a phase, N; 0.0 where contact
            was lost.
        events: number of phase changes located inside the step.
    """

    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    stuck: np.ndarray
    swept: np.ndarray
    normal_force: np.ndarray
    events: np.ndarray


def _evaluate(name: str, plant: Plant, *arguments: Numbers) -> tuple[np.ndarray, ...]:
    accepted = "a Plant, such as Capsule().plant()"
    require(isinstance(plant, Plant), "plant", accepted, plant, TypeError)
    constants = plant._replace(M=0.0, mu=0.0, mass_ratio=0.0)._asdict()
    return evaluate(name, plant.M, plant.mu, *arguments, plant=ordered(_core.PLANT, constants))


def accelerations(
    theta: Numbers, theta_dot: Numbers, x_dot: Numbers, slip: Numbers, u: Numbers, plant: Plant
) -> Accelerations:
    """The accelerations of Eq. (1) and the normal force, clamped at zero: a floor does not pull.

    The normal force is that of `normal_force`, with fused multiply-adds: the last digits can
    differ.
    """
    return Accelerations(*_evaluate("accelerations", plant, theta, theta_dot, x_dot, slip, u))


def normal_force(
    theta: Numbers, theta_dot: Numbers, theta_ddot: Numbers, plant: Plant
) -> np.ndarray:
    """Force of the floor on the platform in N, before the clamp at zero.

    It follows from Newton's law on the vertical, or from Eq. (7).
    """
    return _evaluate("normal_force", plant, theta, theta_dot, theta_ddot)[0]


def driving_force(
    theta: Numbers, theta_dot: Numbers, theta_ddot: Numbers, plant: Plant
) -> np.ndarray:
    """Horizontal force in N with which the pendulum pushes a platform that does not accelerate."""
    return _evaluate("driving_force", plant, theta, theta_dot, theta_ddot)[0]


def friction_force(slip: Numbers, x_dot: Numbers, normal: Numbers, plant: Plant) -> np.ndarray:
    """Coulomb friction on a sliding platform in N, in the direction of `slip`.

    Eq. (1) subtracts it. `normal` must not be negative. The result includes the Stribeck curve, but
    not viscous friction.
    """
    return _evaluate("friction_force", plant, slip, x_dot, normal)[0]


def stick_margin(
    theta: Numbers, theta_dot: Numbers, u: Numbers, plant: Plant
) -> tuple[np.ndarray, np.ndarray]:
    """Static friction limit minus |driving force|, in N, and the driving force itself.

    Stick needs a margin >= 0.
    """
    margin, force = _evaluate("stick_margin", plant, theta, theta_dot, u)
    return margin, force


def contact_phase(
    theta: Numbers, theta_dot: Numbers, x_dot: Numbers, u: Numbers, plant: Plant
) -> np.ndarray:
    """The phase of the contact: the direction of motion.

    At rest it is 0.0 below the static limit, else the load's sign.
    """
    return _evaluate("contact_phase", plant, theta, theta_dot, 0.0, x_dot, u)[0]


def step(
    theta: Numbers,
    theta_dot: Numbers,
    x: Numbers,
    x_dot: Numbers,
    u: Numbers,
    plant: Plant,
    h: Numbers,
) -> Motion:
    """Advances the plant by h seconds at constant torque, through every change of contact phase.

    Without a change of phase this is one step of the fourth-order integrator.
    """
    return Motion(*_evaluate("step", plant, theta, theta_dot, x, x_dot, u, h))
