"""Best-known gaits of the direct-torque task: `python -m baselines.gaits` searches them."""
