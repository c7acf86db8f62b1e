"""Proximal policy optimisation in compiled code; without this package, training works but is slower.

`collection` collects a rollout in one compiled call, `update` makes PPO's update in compiled code, and `ppo.FastPPO` is
the algorithm. Its docstring lists all differences from Stable-Baselines3's PPO.
"""

from agents.fast_ppo.collection import RolloutVecEnv
from agents.fast_ppo.ppo import FastPolicy, FastPPO

__all__ = ["FastPPO", "FastPolicy", "RolloutVecEnv"]
