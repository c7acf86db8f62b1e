"""Derivatives of a trajectory by the plant's constants, the torques and the initial state."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from capsule_gym.checks import nearest, require, short_repr
from capsule_gym.core import _core
from capsule_gym.core.layout import STATE
from capsule_gym.core.native import call, ordered
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, LARGEST_TORQUE, EnvConfig
from capsule_gym.envs.contract import check_periods, check_step, describe
from capsule_gym.envs.resets import check_state
from capsule_gym.parameters import CONSTANTS, NOMINAL, Capsule
from capsule_gym.tasks.task import CONTROL_DT

# The constants by which a trajectory can be differentiated.
PLANT = ("M", "mu", *CONSTANTS)
KNOWN = (*PLANT, "torque", "torques", "state")
NUM_INPUTS = len(_core.TRAJECTORY)
"""Number of inputs of a trajectory before its torques."""


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


def trajectory_inputs(capsule: Capsule, state: Any, torques: Any) -> np.ndarray:
    """The inputs of a trajectory: the numbers of `_core.TRAJECTORY`, then the torques, N m."""
    values = {**vars(capsule), **dict(zip(STATE, state, strict=True))}
    values["paper"] = float(capsule.normal_force == "paper")
    return np.append(ordered(_core.TRAJECTORY, values), torques)


def simulate(
    inputs: np.ndarray, partials: np.ndarray, steps: int, physics_dt: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """A trajectory and its derivatives along several directions, without checks.

    Args:
        inputs: those of `trajectory_inputs` for n torques.
        partials: the derivatives of the inputs along the directions, shape (inputs, directions).
        steps: integrator steps of the interval in which a torque acts.
        physics_dt: the integrator's step, s.

    Returns:
        States and number of events so far, shape (n + 1, 5); their derivatives, shape (n + 1, 4,
        directions); the first interval in which an episode would have terminated, or -1.
    """
    count = len(inputs) - NUM_INPUTS
    directions = partials.shape[1]
    width = _core.DIRECTIONS
    states = np.empty((count + 1, 5))
    slopes = np.empty((count + 1, 4, directions))
    for first in range(0, max(directions, 1), width):
        block = partials[:, first : first + width]
        used = block.shape[1]
        seeds = np.zeros((len(inputs), width))
        seeds[:, :used] = block
        given = seeds if directions else 0
        found = np.empty((count + 1, 4, width))
        ended = call("trajectory", inputs, given, count, steps, physics_dt, states, found)
        slopes[..., first : first + used] = found[..., :used]
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
        >>> found = sensitivity([-1.0, 0.0, 0.0, 0.0], [0.8] * 5, ["mu"], capsule=Capsule(mu=0.05))
        >>> found.states.shape, found.derivatives["mu"].shape
        ((6, 4), (6, 4))
    """
    require(isinstance(capsule, Capsule), "capsule", "a Capsule", capsule, TypeError)
    options = EnvConfig(capsule=capsule, control_dt=control_dt, physics_dt=physics_dt)
    settings = describe(options, None).settings
    check_periods(options, settings, law=False)
    check_step(capsule, capsule.M, capsule.mu, settings)
    (start,) = check_state("state", state, 1)
    inputs = trajectory_inputs(capsule, start, check_torques(torques))
    check_wrt(wrt, capsule)
    blocks = [partials_by(name, inputs) for name in wrt]
    partials = np.hstack([np.empty((len(inputs), 0)), *blocks])
    steps = int(settings.physics_steps * settings.law_steps)
    states, slopes, ended = simulate(inputs, partials, steps, settings.physics_dt)
    if ended >= 0:
        times = f"between {ended * control_dt:g} and {(ended + 1) * control_dt:g} s"
        raise ValueError(
            "torques must keep |theta| < pi/2 and the platform on the floor, got an episode that "
            f"would terminate in torques[{ended}], {times}"
        )
    derivatives = {}
    first = 0
    for name, block in zip(wrt, blocks, strict=True):
        last = first + block.shape[1]
        own = slopes[..., first:last]
        derivatives[name] = own if name in ("torques", "state") else own[..., 0]
        first = last
    events = states[:, 4].astype(np.int64)
    return Sensitivity(states[:, :4], derivatives, events)


def subset(values: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """The values of those names that have one."""
    return {name: values[name] for name in names if name in values}


def check_torques(torques: Any) -> np.ndarray:
    """Returns the torques as an array, or raises an error."""
    accepted = f"a sequence of numbers within +-{LARGEST_TORQUE:g} N m"
    try:
        array = np.asarray(torques, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"torques must be {accepted}, got {short_repr(torques)}") from None
    inside = np.abs(array) <= LARGEST_TORQUE
    require(array.ndim == 1 and bool(inside.all()), "torques", accepted, torques)
    return array


def check_wrt(wrt: Any, capsule: Capsule) -> None:
    """Raises an error unless the trajectory can be differentiated by all names."""
    sequence = isinstance(wrt, Sequence) and not isinstance(wrt, str)
    if not sequence or not all(isinstance(name, str) for name in wrt):
        raise TypeError(f"wrt must be a sequence of names out of {KNOWN}, got {short_repr(wrt)}")
    for name in wrt:
        if name not in KNOWN:
            similar = nearest(name, KNOWN)
            raise ValueError(f"wrt must contain names out of {KNOWN}, got {name!r}{similar}")
        if name == "stribeck_speed" and capsule.stribeck_speed == 0.0:
            raise ValueError(
                "wrt may contain 'stribeck_speed' only where capsule.stribeck_speed > 0, got 0.0"
            )


def partials_by(name: str, inputs: np.ndarray) -> np.ndarray:
    """The derivatives of a trajectory's inputs by a name of `wrt`, shape (inputs, directions)."""
    count = len(inputs)
    if name == "torque":
        factor = inputs.copy()
        factor[:NUM_INPUTS] = 0.0
        return factor[:, None]
    if name == "torques":
        return np.eye(count, count - NUM_INPUTS, -NUM_INPUTS)
    if name == "state":
        return np.eye(count, len(STATE), -_core.TRAJECTORY.index(STATE[0]))
    return np.eye(count, 1, -_core.TRAJECTORY.index(name))
