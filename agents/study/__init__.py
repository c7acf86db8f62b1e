"""Rows of the leaderboard trained over seeds, side by side: `python -m agents.study`; what is chosen by `.tune`."""
