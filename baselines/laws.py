"""The control laws by name, under their public name."""

from capsule_gym.control.laws import LAWS, find_law

__all__ = ["LAWS", "find_law"]
