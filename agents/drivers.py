"""The names of what can drive the capsule in a browser; like the names of policies, they need nothing compiled."""

from __future__ import annotations

from baselines.policies import SCRIPTED
from capsule_gym.committed import policy_names


def trained(name: str) -> bool:
    """Whether a driver is a trained policy."""
    return name in policy_names()


def driver_names() -> list[str]:
    """Everything that can drive the capsule in a browser: what acts inside the compiled step, and trained policies.

    Of a policy the run with the lowest seed.
    """
    inside = [each.name for each in SCRIPTED.values() if "controller" in each.env_kwargs or each.name == "zero"]
    return [*inside, *policy_names()]
