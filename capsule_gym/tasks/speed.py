"""The speed task, `CapsuleStickSlip-v0`: forwards as fast as possible."""

from capsule_gym.tasks.task import Task

TASK = Task(name="speed")
