"""Evaluation of policies: sets, episodes, statistics, and the optimal speed of a plant."""
