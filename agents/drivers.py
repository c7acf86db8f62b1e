"""The names of what can drive the capsule in a browser; like the names of policies, they need nothing compiled."""

from __future__ import annotations

from baselines.policies import SCRIPTED
from capsule_gym.policy import policy_names

# Whose actions on the frozen plants are recorded, as `web.recordings` has it; elsewhere they cannot drive.
RECORDED = ("optimum-nominal", "optimum-oracle")


def trained(name: str) -> bool:
    """Whether a driver is a trained policy."""
    return name in policy_names()


def driver_names() -> list[str]:
    """Everything that can drive the capsule in a browser; of a trained policy the run with the lowest seed."""
    return [*SCRIPTED, *policy_names()]
