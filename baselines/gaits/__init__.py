"""Best-known gaits, the yardstick of the direct-torque task: `python -m baselines.gaits` searches them."""
