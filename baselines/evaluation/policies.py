"""Policies by name or path, under their public name."""

from capsule_gym.evaluation.candidates import find_candidate, wrap_policy

__all__ = ["find_candidate", "wrap_policy"]
