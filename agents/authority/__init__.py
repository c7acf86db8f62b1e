"""How much authority over a law an agent should have: `python -m agents.authority`."""
