"""How an agent is trained with Stable-Baselines3, and what a run's folder holds."""
