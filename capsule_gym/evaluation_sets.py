"""Evaluation sets, under their public name."""

from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec, load_set, parse_set

__all__ = ["EvaluationSet", "PlantSpec", "load_set", "parse_set"]
