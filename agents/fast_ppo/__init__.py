"""Proximal policy optimisation in compiled code; training works without this package, more slowly.

`collection` collects a rollout in one compiled call, `update` makes an update in another, and `ppo.FastPPO` is the
algorithm, whose docstring names every difference to Stable-Baselines3's PPO.
"""

from agents.fast_ppo.collection import RolloutVecEnv
from agents.fast_ppo.ppo import FastPolicy, FastPPO

__all__ = ["FastPPO", "FastPolicy", "RolloutVecEnv"]
