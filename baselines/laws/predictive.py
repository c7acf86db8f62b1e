"""A control law for late, noisy measurements and a lagging motor: an observer and a predictor around the gait.

The sensors show an earlier state. An observer with fixed gains estimates it, and the nominal model predicts from it,
with the torques returned since, the state at which the next torque acts. M, mu and the bias of the measured x_dot are
estimated on the way. The position is not measured.
"""

from __future__ import annotations

from baselines.laws.gains import plant_constants
from baselines.laws.gait import LIGHTEST, NO_REFERENCE, gait_constants, known_parameters
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller, CoreLaw
from capsule_gym.parameters import NOMINAL

# The friction coefficient at first.
FIRST_MU = 0.02
# The observer's estimate at first: 1.0 after the first measurement, theta (rad), theta_dot (rad/s), x_dot (m/s), the
# motor's torque after its lag (N m), M (kg), mu and the bias of the measured x_dot (m/s). Earlier torques follow.
ESTIMATE = (0.0, 0.0, 0.0, 0.0, 0.0, NOMINAL.M, FIRST_MU, 0.0)


def gait_predictive() -> Controller:
    """The gait on the state of the observer and predictor."""
    constants = {**gait_constants(known_parameters()), **plant_constants(NOMINAL.plant())}
    law = CoreLaw("gait_predictive", **constants, lightest=LIGHTEST, dt=LAW_DT)
    memory = (*ESTIMATE, *(0.0,) * (law.cells - len(ESTIMATE)))
    return Controller(law.name, law, NO_REFERENCE, memory)
