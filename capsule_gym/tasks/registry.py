"""The tasks by their names."""

from typing import Any

from capsule_gym.checks import check_name, require
from capsule_gym.core import _core
from capsule_gym.tasks import goal, speed, velocity
from capsule_gym.tasks.task import Task

TASKS = {task.name: task for task in (speed.TASK, goal.TASK, velocity.TASK)}


def find_task(value: Any) -> Task:
    """The task that the environment's argument `task` names; a `Task` is returned unchanged.

    Raises:
        TypeError: if it is neither a string nor a `Task`.
        ValueError: if the core has no task of that name.
    """
    if isinstance(value, Task):
        accepted = f"one of {sorted(_core.TASKS)}; a wrapper of the environment makes other tasks"
        require(value.name in _core.TASKS, "task.name", accepted, value.name)
        return value
    return TASKS[check_name("task", value, Task, TASKS)]
