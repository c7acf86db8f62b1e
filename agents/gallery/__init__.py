"""The pictures of the site that move, the figure that compares them, and the card: `python -m agents.gallery`."""
