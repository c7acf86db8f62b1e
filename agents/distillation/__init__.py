"""Distillation of the optimum into networks by DAgger: `python -m agents.distillation`."""
