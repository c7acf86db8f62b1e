"""Evaluation of policies: frozen sets, episodes, statistics and tables."""
