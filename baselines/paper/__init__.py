"""The paper computed anew: `python -m baselines.paper` prints its numbers beside ours."""
