"""Training of agents with Stable-Baselines3, and the contents of a run's folder."""
