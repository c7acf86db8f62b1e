"""The scripted baselines: the paper's trajectories, its control laws and policies made of them.

The functions here are what the environment's argument `controller` takes, as in `controller="baselines:adaptive"`.
"""

from baselines.laws.adaptive import adaptive, adaptive_as_published, compliant
from baselines.laws.feedback_linearisation import epc, feedback_linearising
from baselines.laws.gait import gait, gait_identifying

__all__ = ["adaptive", "adaptive_as_published", "compliant", "epc", "feedback_linearising", "gait", "gait_identifying"]
