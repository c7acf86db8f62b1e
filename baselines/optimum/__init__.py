"""The optimum of the direct-torque task by dynamic programming: `python -m baselines.optimum` computes it."""

from baselines.optimum.cycles import Cycle, cycle
from baselines.optimum.records import optimal_speed

__all__ = ["Cycle", "cycle", "optimal_speed"]
