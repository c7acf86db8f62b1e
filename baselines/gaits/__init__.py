"""Best-known gaits of the direct-torque task: `python -m baselines.gaits` lists them."""

from pathlib import Path

# Half the environment's own step: switching times matter, and shorter steps gained nothing worth their cost.
GAIT_DT = 0.01
# Folder of the results.
FOLDER = Path(__file__).with_name("data")
