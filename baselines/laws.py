"""The control laws by name, under the former name of the module."""

from capsule_gym.control.laws import LAWS, find_law

__all__ = ["LAWS", "find_law"]
