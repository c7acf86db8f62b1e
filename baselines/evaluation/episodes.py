"""Evaluation of policies, under the former name of the module."""

from capsule_gym.evaluation.episodes import evaluate, summarise, validation_set

__all__ = ["evaluate", "summarise", "validation_set"]
