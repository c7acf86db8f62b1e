"""Tables and figures of the documentation's result pages: `python -m agents.analysis`."""
