"""Control laws of the core and by their import strings, under their public names."""

from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.control.lookup import find_controller

__all__ = ["Controller", "CoreLaw", "find_controller"]
