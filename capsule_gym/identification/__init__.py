"""From a rig to a policy: logs, the identification of a plant, and derivatives of trajectories."""

from capsule_gym.identification.derivatives import Sensitivity, sensitivity
from capsule_gym.identification.excitation import Excitation
from capsule_gym.identification.fit import Fit, identify
from capsule_gym.identification.recording import record

__all__ = ["Excitation", "Fit", "Sensitivity", "identify", "record", "sensitivity"]
