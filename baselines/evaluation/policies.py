"""Policies by name or path, under the former name of the module."""

from capsule_gym.evaluation.candidates import find_candidate, wrap_policy

__all__ = ["find_candidate", "wrap_policy"]
