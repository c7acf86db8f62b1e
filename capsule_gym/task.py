"""The metrics and the terminations of an episode, under the former name of the module."""

from capsule_gym.tasks.task import METRICS, Termination

__all__ = ["METRICS", "Termination"]
