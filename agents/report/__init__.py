"""One page about a run, about some policies, or about the whole leaderboard: `python -m agents.report`."""

COMMAND = "python -m agents.report"
