"""Elementary functions with the same bits on every machine, under their public name."""

from capsule_gym.core.elementary import arccos, log, sincos

__all__ = ["arccos", "log", "sincos"]
