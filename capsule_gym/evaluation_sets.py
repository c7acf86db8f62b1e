"""Evaluation sets, under the former name of the module."""

from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec, load_set, parse_set

__all__ = ["EvaluationSet", "PlantSpec", "load_set", "parse_set"]
