"""What the searches of `baselines.paper.optimal_profiles` are asked for unless told otherwise, and their file."""

from pathlib import Path

PROG = "python -m baselines.paper.optimal_profiles"
DATA = Path(__file__).with_name("optimal_profiles.json")
GENERATIONS = 200
SEED = 0
