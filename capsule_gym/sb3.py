"""The batch and the policy for Stable-Baselines3, under their public name."""

from capsule_gym.envs.sb3 import AsymmetricPolicy, CapsuleSB3VecEnv, FixedScale

__all__ = ["AsymmetricPolicy", "CapsuleSB3VecEnv", "FixedScale"]
