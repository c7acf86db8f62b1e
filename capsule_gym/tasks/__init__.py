"""The tasks, each a module with a `capsule_gym.task.Task` named `TASK`; `capsule_gym.task.TASKS` lists them."""

from capsule_gym.parameters import Capsule, Randomization

# The floors of the tasks that need grip: rubber to plastic, and what sticks takes a third more force to move.
ROUGH = Randomization(M=(0.45, 0.55), mu=(0.05, 0.5), log_mu=True)
STICKY = Capsule(static_ratio=1.3)
