"""The environments: a single one, a batch, and a batch for Stable-Baselines3; their arguments and
their state.
"""
