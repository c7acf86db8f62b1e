"""The evaluation of policies, under its former name: it is in `capsule_gym.evaluation`."""
