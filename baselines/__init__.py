"""The scripted baselines: the paper's trajectories, control laws and policies made of them.

The environment's argument `controller` accepts the laws of `baselines.laws.LAWS`, and those of `TASK_LAWS` in their
tasks, as in `controller="baselines:adaptive"`. Each law is imported at its first use.
"""

from typing import Any

from baselines.laws import LAWS, TASK_LAWS, find_law

__all__ = sorted(LAWS)


def __getattr__(name: str) -> Any:
    return find_law(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *TASK_LAWS})
