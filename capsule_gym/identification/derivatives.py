"""Derivatives of a trajectory by the plant's constants, the torques and the initial state."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from capsule_gym.checks import nearest, require, short_repr
from capsule_gym.core import _core
from capsule_gym.core.native import call, ordered
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, LARGEST_TORQUE, EnvConfig
from capsule_gym.envs.contract import check_periods, check_step, describe
from capsule_gym.envs.resets import check_state
from capsule_gym.parameters import CONSTANTS, NOMINAL, Capsule
from capsule_gym.tasks.task import CONTROL_DT

STATE = ("theta", "theta_dot", "x", "x_dot")
# The constants by which a trajectory can be differentiated, in the order of the inputs.
PLANT = ("M", "mu", *CONSTANTS)


class Sensitivity(NamedTuple):
    """A trajectory and its derivatives.

    Attributes:
        states: theta, theta_dot, x, x_dot at the start and at the end of every interval, shape (n +
            1, 4), SI units.
        derivatives: the derivatives of `states` by each name in `wrt`: shape (n + 1, 4), of "state"
            (n + 1, 4, 4) with the component of the initial state last, of "torques" (n + 1, 4, n).
        events: number of changes of the contact phase up to each state, shape (n + 1,), int64.
    """

    states: np.ndarray
    derivatives: dict[str, np.ndarray]
    events: np.ndarray


def simulate(
    inputs: np.ndarray, partials: np.ndarray, steps: int, physics_dt: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """A trajectory and its derivatives along several directions, without checks.

    Args:
        inputs: the numbers of `_core.TRAJECTORY` and n torques, N m.
        partials: the derivatives of the inputs along the directions, shape (inputs, directions).
        steps: integrator steps of the interval in which a torque acts.
        physics_dt: the integrator's step, s.

    Returns:
        States and number of events so far, shape (n + 1, 5); their derivatives, shape (n + 1, 4,
        directions); the first interval in which an episode would have terminated, or -1.
    """
    count, directions, width = (
        len(inputs) - len(_core.TRAJECTORY),
        partials.shape[1],
        _core.DIRECTIONS,
    )
    states, slopes = np.empty((count + 1, 5)), np.empty((count + 1, 4, directions))
    for first in range(0, max(directions, 1), width):
        part = partials[:, first : first + width]
        seeds, found = np.zeros((len(inputs), width)), np.empty((count + 1, 4, width))
        seeds[:, : part.shape[1]] = part
        ended = call(
            "trajectory",
            inputs,
            seeds if directions else 0,
            count,
            steps,
            physics_dt,
            states,
            found,
        )
        slopes[..., first : first + width] = found[..., : part.shape[1]]
    return states, slopes, ended


def sensitivity(
    state: Any,
    torques: Any,
    wrt: Sequence[str] = ("M", "mu", "torque", "state"),
    *,
    capsule: Capsule = NOMINAL,
    control_dt: float = CONTROL_DT,
    physics_dt: float = DIRECT_PHYSICS_DT,
) -> Sensitivity:
    """The trajectory of a plant under given torques, and its derivatives.

    The derivatives are exact, by forward differentiation of the environment's own step, and pass
    through every change of the contact phase: the time of an event follows its inputs by the
    implicit function theorem. They are local: the trajectory itself is not smooth where a small
    change adds or removes an event (docs/identification.md).

    Args:
        state: theta (rad), theta_dot (rad/s), x (m), x_dot (m/s) at the start.
        torques: torques of the motor, N m, shape (n,), each constant for `control_dt`.
        wrt: constants of the `Capsule` by name, "torque" for a common factor of all torques,
            "torques" for each torque, and "state" for the initial state.
        capsule: the plant.
        control_dt: duration of a torque, s.
        physics_dt: the integrator's step, s.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range, or an episode would terminate: the pendulum
            meets the platform, or the platform leaves the floor.

    Examples:
        >>> found = sensitivity([-1.0, 0.0, 0.0, 0.0], [0.8] * 5, wrt=("mu",), capsule=Capsule(mu=0.05))
        >>> found.states.shape, found.derivatives["mu"].shape
        ((6, 4), (6, 4))
    """
    require(isinstance(capsule, Capsule), "capsule", "a Capsule", capsule, TypeError)
    options = EnvConfig(capsule=capsule, control_dt=control_dt, physics_dt=physics_dt)
    settings = describe(options, None).settings
    check_periods(options, settings, law=False)
    check_step(capsule, capsule.M, capsule.mu, settings)
    (start,) = check_state("state", state, 1)
    accepted = f"a sequence of numbers within +-{LARGEST_TORQUE:g} N m"
    try:
        commands = np.asarray(torques, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"torques must be {accepted}, got {short_repr(torques)}") from None
    require(
        commands.ndim == 1 and bool((np.abs(commands) <= LARGEST_TORQUE).all()),
        "torques",
        accepted,
        torques,
    )
    inputs = np.concatenate([constant_inputs(capsule), start, commands])
    first = len(_core.TRAJECTORY)
    # The first input, and the number of inputs, of each name.
    spans = {name: (n, 1) for n, name in enumerate(PLANT)}
    spans |= {"torque": (first, 1), "torques": (first, len(commands)), "state": (first - 4, 4)}
    known = tuple(spans)
    if (
        isinstance(wrt, str)
        or not isinstance(wrt, Sequence)
        or not all(isinstance(name, str) for name in wrt)
    ):
        raise TypeError(f"wrt must be a sequence of names out of {known}, got {short_repr(wrt)}")
    for name in wrt:
        if name not in known:
            raise ValueError(
                f"wrt must contain names out of {known}, got {name!r}{nearest(name, known)}"
            )
        if name == "stribeck_speed" and capsule.stribeck_speed == 0.0:
            raise ValueError(
                "wrt may contain 'stribeck_speed' only where capsule.stribeck_speed > 0, got 0.0"
            )
    factor = np.append(np.zeros(first), commands)[:, None]
    own = [
        factor if name == "torque" else np.eye(len(inputs), spans[name][1], -spans[name][0])
        for name in wrt
    ]
    partials = np.hstack([factor[:, :0], *own])
    steps = int(settings.physics_steps * settings.law_steps)
    states, slopes, ended = simulate(inputs, partials, steps, settings.physics_dt)
    if ended >= 0:
        raise ValueError(
            f"torques must keep |theta| < pi/2 and the platform on the floor, got an episode that would terminate in "
            f"torques[{ended}], between {ended * control_dt:g} and {(ended + 1) * control_dt:g} s"
        )
    ends = np.cumsum([spans[name][1] for name in wrt], dtype=int)
    parts = zip(
        wrt, np.split(slopes, ends, axis=-1), strict=False
    )  # nothing is behind the last end
    derivatives = {
        name: part if name in ("torques", "state") else part[..., 0] for name, part in parts
    }
    return Sensitivity(states[:, :4], derivatives, states[:, 4].astype(np.int64))


def constant_inputs(capsule: Capsule) -> np.ndarray:
    """The constants among the inputs of a trajectory."""
    return ordered(
        _core.TRAJECTORY[:-4], {**vars(capsule), "paper": float(capsule.normal_force == "paper")}
    )
