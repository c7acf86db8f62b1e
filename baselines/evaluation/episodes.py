"""Evaluation of policies, under its public name."""

from capsule_gym.evaluation.episodes import evaluate, summarise, validation_set

__all__ = ["evaluate", "summarise", "validation_set"]
