"""Whole episodes of a policy inside the core, under the former name of the module."""

from capsule_gym.policies.rollout import rollout

__all__ = ["rollout"]
