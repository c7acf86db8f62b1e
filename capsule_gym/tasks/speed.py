"""The speed task, `CapsuleStickSlip-v0`: forwards as fast as possible.

Its reward is in `core/tasks/speed.hpp`.
"""

from capsule_gym.tasks.task import Task

TASK = Task(name="speed")
