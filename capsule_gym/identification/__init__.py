"""From a rig to a policy: logs, the identification of a plant, and derivatives of trajectories."""

from capsule_gym.identification.derivatives import Sensitivity, sensitivity
from capsule_gym.identification.excitation import Excitation
from capsule_gym.identification.fit import identify
from capsule_gym.identification.recording import record
from capsule_gym.identification.result import Fit
from capsule_gym.identification.sampling import on_grid

__all__ = ["Excitation", "Fit", "Sensitivity", "identify", "on_grid", "record", "sensitivity"]
