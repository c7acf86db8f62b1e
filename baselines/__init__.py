"""The scripted baselines: the paper's trajectories, its control laws and policies made of them.

The functions here are what the environment's argument `controller` takes, as in `controller="baselines:adaptive"`. Each
is imported when it is first asked for, since numba, which takes most of a second, comes with it.
"""

from typing import TYPE_CHECKING

from capsule_gym.later import later

if TYPE_CHECKING:
    from baselines.laws.adaptive import adaptive, adaptive_as_published, compliant
    from baselines.laws.feedback_linearisation import epc, feedback_linearising
    from baselines.laws.gait import gait, gait_identifying

__all__ = ["adaptive", "adaptive_as_published", "compliant", "epc", "feedback_linearising", "gait", "gait_identifying"]

__getattr__, __dir__ = later(
    __name__,
    {
        "adaptive": ".laws.adaptive",
        "adaptive_as_published": ".laws.adaptive",
        "compliant": ".laws.adaptive",
        "epc": ".laws.feedback_linearisation",
        "feedback_linearising": ".laws.feedback_linearisation",
        "gait": ".laws.gait",
        "gait_identifying": ".laws.gait",
    },
)
