"""The frozen evaluation sets, and the criteria of each task."""
