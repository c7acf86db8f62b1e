"""The evaluation of policies, which is in `capsule_gym.evaluation`."""
