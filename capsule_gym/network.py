"""Whole episodes of a policy inside the core, under their public name."""

from capsule_gym.policies.rollout import rollout

__all__ = ["rollout"]
