"""The tasks, each a module with a `capsule_gym.task.Task` named `TASK`; `capsule_gym.task.TASKS` lists them."""

from capsule_gym.parameters import Capsule, Randomization

# Defaults of the tasks that need grip. Their floors range from rubber to plastic; static friction is about a third
# larger than kinetic friction.
DEFAULTS = {
    "capsule": Capsule(static_ratio=1.3),
    "randomization": Randomization(M=(0.45, 0.55), mu=(0.05, 0.5), log_mu=True),
    "energy_weight": 0.0,
    "termination_penalty": 3.0,
}
