"""Every policy on every frozen set: what `python -m agents.leaderboard` writes and checks."""
