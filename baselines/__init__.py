"""The scripted baselines: the paper, dynamic programming, LQR, MPC and tuning.

The control laws are in `capsule_gym.control.laws`, and also have the names of this package:
`baselines.adaptive()` is the law of the environment's argument `controller="baselines:adaptive"`.
"""

from capsule_gym.control.laws.adaptive import (
    adaptive,
    adaptive_as_published,
    adaptive_optimal_profile,
)
from capsule_gym.control.laws.feedback_linearisation import (
    epc,
    feedback_linearising,
    feedback_linearising_optimal_profile,
)
from capsule_gym.control.laws.gait import gait, gait_predictive, goal_pulses, velocity_pulses
from capsule_gym.control.laws.periodic import open_loop, open_loop_real, oscillator, pd

__all__ = [
    "adaptive",
    "adaptive_as_published",
    "adaptive_optimal_profile",
    "epc",
    "feedback_linearising",
    "feedback_linearising_optimal_profile",
    "gait",
    "gait_predictive",
    "goal_pulses",
    "open_loop",
    "open_loop_real",
    "oscillator",
    "pd",
    "velocity_pulses",
]
