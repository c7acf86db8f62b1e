"""Control laws of the core and of import strings, under the former name of the module."""

from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.control.lookup import find_controller

__all__ = ["Controller", "CoreLaw", "find_controller"]
