"""Elementary functions with the same bits on every machine, under the former name of the module."""

from capsule_gym.core.elementary import arccos, log, sincos

__all__ = ["arccos", "log", "sincos"]
