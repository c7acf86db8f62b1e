"""The plant and its disturbances: constants, their distributions and their limits."""

from capsule_gym.parameters.capsule import CONSTANTS, NOMINAL, Capsule, NormalForce, Plant
from capsule_gym.parameters.disturbances import DISTURBANCES, REAL, SENSORS, Disturbances
from capsule_gym.parameters.randomization import RANDOMIZATIONS, Randomization

__all__ = [
    "CONSTANTS",
    "DISTURBANCES",
    "NOMINAL",
    "RANDOMIZATIONS",
    "REAL",
    "SENSORS",
    "Capsule",
    "Disturbances",
    "NormalForce",
    "Plant",
    "Randomization",
]
