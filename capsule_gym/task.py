"""The metrics and the terminations of an episode, under their public name."""

from capsule_gym.tasks.task import METRICS, Termination

__all__ = ["METRICS", "Termination"]
