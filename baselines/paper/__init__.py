"""Reproduction of the paper: `python -m baselines.paper` prints its numbers next to ours."""
