"""The scripted baselines: the paper's trajectories, control laws and policies made of them.

The environment's argument `controller` accepts the laws of `baselines.laws.LAWS`, as in
`controller="baselines:adaptive"`; those of another task in that task.
"""

from baselines.laws import LAWS

__all__ = sorted(LAWS)
globals().update(LAWS)
