"""Learned agents: training, evaluation, the leaderboard; in the checkout only, not installed."""
