"""A gait without a clock: the torque is a polynomial of the state, and a guard keeps the contact.

`gait` does not observe the plant and follows no reference. The guard identifies a platform that is
lighter than those of the search by the momentum that the pendulum gives it. `gait_predictive` is
for late, noisy measurements and a lagging motor, `goal_pulses` and `velocity_pulses` for the tasks
`goal` and `velocity`.
"""

from collections.abc import Sequence

from capsule_gym.checks import check_number, require
from capsule_gym.control.controller import LAW_DT, Controller, CoreLaw
from capsule_gym.control.laws.gains import NO_REFERENCE, known_parameters, plant_constants
from capsule_gym.core import _core
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.tasks.task import TORQUE_LIMIT

# In the order of the core: the coefficients phi_ijk of theta^i theta_dot^j x_dot^k and of the step
# in the direction of slip; the guard's gain in N m s^2, and the theta_dot^2 cos(theta), 1/s^2, from
# which it acts.
PARAMETERS = tuple(_core.LAWS["gait"][0].partition(" torque_limit")[0].split())
# The parameters were searched on platforms of this mass and larger ones, kg.
_WIDE = RANDOMIZATIONS["wide"].M
assert _WIDE is not None
LIGHTEST = _WIDE[0]
# The friction coefficient that the observer assumes at first.
FIRST_MU = 0.02
# The observer's estimate at first: 1.0 after the first measurement, theta (rad), theta_dot (rad/s),
# x_dot (m/s), the motor's torque after its lag (N m), M (kg), mu and the bias of the measured x_dot
# (m/s). Earlier torques follow.
ESTIMATE = (0.0, 0.0, 0.0, 0.0, 0.0, NOMINAL.M, FIRST_MU, 0.0)
# The memory of the pulses at first, behind that of the filter: the phase, a return of the pendulum;
# the direction of the pulse, its rate (rad/s), its start (m), its gain (m s^2) and the time since
# its end (s).
FIRST_PULSE = (1.0, 1.0, 0.0, 0.0, 1e-4, 0.0)


def gait_constants(parameters: Sequence[float] | None = None) -> dict[str, float]:
    """The constants that the laws with a gait share, by the names that the core gives them."""
    given = known_parameters("gait") if parameters is None else parameters
    accepted = f"{len(PARAMETERS)} numbers, {', '.join(PARAMETERS)}"
    require(len(given) == len(PARAMETERS), "parameters", accepted, given)
    constants = {}
    for name, value in zip(PARAMETERS, given, strict=True):
        constants[name] = check_number(f"parameters, {name},", value, "a finite number")
    constants["torque_limit"] = TORQUE_LIMIT
    return constants


def gait(parameters: Sequence[float] | None = None) -> Controller:
    """The gait, whose torque is a function of theta, theta_dot and x_dot; M and mu are hidden.

    Its guard estimates M while the platform slips and acts earlier on platforms lighter than those
    of `wide`.

    Args:
        parameters: numbers in the order of `PARAMETERS`; None for the tuned ones.

    Raises:
        TypeError: if a parameter is not a number.
        ValueError: if a parameter is not finite, or their number is wrong.
    """
    pendulum = {name: getattr(NOMINAL, name) for name in ("m", "l", "g")}
    law = CoreLaw("gait", **gait_constants(parameters), **pendulum, lightest=LIGHTEST, dt=LAW_DT)
    return Controller(law.name, law, NO_REFERENCE, memory=(0.0,) * law.cells)


def gait_predictive() -> Controller:
    """The gait on the state of an observer and a predictor.

    The sensors show an earlier state. An observer with fixed gains estimates it, and the nominal
    model predicts from it, with the torques returned since, the state at which the next torque
    acts. M, mu and the bias of the measured x_dot are estimated on the way. The position is not
    measured.
    """
    constants = {**gait_constants(), **plant_constants(NOMINAL.plant())}
    law = CoreLaw("gait_predictive", **constants, lightest=LIGHTEST, dt=LAW_DT)
    earlier_torques = (0.0,) * (law.cells - len(ESTIMATE))
    return Controller(law.name, law, NO_REFERENCE, ESTIMATE + earlier_torques)


def goal_pulses() -> Controller:
    """The law of the task `goal`: the gait and torque pulses, or strokes on smooth floors.

    The size of the pulses adapts to the floor. The law reads the goal's position, which follows the
    reference, and the exact position of the platform.
    """
    return _pulses("goal_pulses", "goal")


def velocity_pulses() -> Controller:
    """The law of the task `velocity`: the gait and torque pulses, towards the target's position.

    The position is that of the target 0.3 s later.
    """
    return _pulses("velocity_pulses", "velocity")


def _pulses(name: str, task: str) -> Controller:
    pendulum = {key: getattr(NOMINAL, key) for key in ("m", "l", "g", "k", "c")}
    law = CoreLaw(name, **gait_constants(), **pendulum, dt=LAW_DT)
    filtered = (0.0,) * (law.cells - len(FIRST_PULSE))
    return Controller(name, law, NO_REFERENCE, filtered + FIRST_PULSE, task=task)
