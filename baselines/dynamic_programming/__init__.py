"""Dynamic programming for the direct-torque task: `python -m baselines.dynamic_programming` computes the policies."""

from pathlib import Path

# N: the observation is coarser than the state, so a smaller predicted force may be a loss of contact.
MIN_NORMAL_FORCE = 0.02
# Folder of the archive.
FOLDER = Path(__file__).with_name("data")
