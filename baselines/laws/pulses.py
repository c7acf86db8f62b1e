"""Laws for the tasks `goal` and `velocity`: a gait towards the goal, then pulses whose size adapts to the floor.

On smooth floors the law for the task `goal` moves the platform by strokes instead. In the task `velocity` the goal is
the position of the target 0.3 s later. The laws read the goal's position, which follows their reference, and the exact
position of the platform.
"""

from __future__ import annotations

from baselines.laws.gait import NO_REFERENCE, gait_constants, known_parameters
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller, CoreLaw
from capsule_gym.parameters import NOMINAL

# The law's own memory at first, behind that of the filter: the phase, a return of the pendulum; the direction of the
# pulse, its rate (rad/s), its start (m), its gain (m s^2) and the time since its end (s).
START = (1.0, 1.0, 0.0, 0.0, 1e-4, 0.0)


def goal_pulses() -> Controller:
    """The law of the task `goal`: the gait and torque pulses, or strokes on smooth floors."""
    return _controller("goal_pulses", "goal")


def velocity_pulses() -> Controller:
    """The law of the task `velocity`: the gait and torque pulses towards the target."""
    return _controller("velocity_pulses", "velocity")


def _controller(name: str, task: str) -> Controller:
    pendulum = {key: getattr(NOMINAL, key) for key in ("m", "l", "g", "k", "c")}
    law = CoreLaw(name, **gait_constants(known_parameters()), **pendulum, dt=LAW_DT)
    return Controller(name, law, NO_REFERENCE, (*(0.0,) * (law.cells - len(START)), *START), task=task)
