"""One steady cycle of a policy, and where its speed comes from: `python -m agents.cycles`."""
