"""The environments, single, as a batch, and for Stable-Baselines3, with their arguments."""
