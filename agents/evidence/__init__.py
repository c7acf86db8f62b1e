"""What the results of the leaderboard show, and how surely: `python -m agents.evidence`."""
