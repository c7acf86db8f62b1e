"""Trains rows of the leaderboard over seeds: `python -m agents.study`."""
