"""Dynamic programming for the direct-torque task.

`python -m baselines.dynamic_programming` computes the policies.
"""
