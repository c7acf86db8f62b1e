"""A network that is taught by the optimum: `python -m agents.distil`."""
