"""Evaluation of policies on the frozen sets: policies by name or path, episodes, and statistics."""
