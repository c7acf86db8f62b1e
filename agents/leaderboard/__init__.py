"""The leaderboard: every policy on every frozen set."""
