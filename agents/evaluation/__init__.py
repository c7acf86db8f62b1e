"""What a policy is worth: frozen sets, episodes, statistics, and the tables they stand in."""
