"""Dynamic programming for the direct-torque task: `python -m baselines.dynamic_programming` computes the policies."""

from pathlib import Path

# Folder of the archive.
FOLDER = Path(__file__).with_name("data")
