"""One HTML page about runs, policies or the whole leaderboard: `python -m agents.report`."""

COMMAND = "python -m agents.report"
