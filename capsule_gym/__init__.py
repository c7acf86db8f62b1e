"""capsule_gym: friction-driven locomotion of a capsule robot as a Gymnasium environment.

Importing the package registers `CapsuleStickSlip-v0` and the environments of the other tasks. The environments and
policies are imported at their first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

from capsule_gym.controller import Controller
from capsule_gym.parameters import Capsule, Disturbances, Randomization
from capsule_gym.task import ENV_ID, TASKS

if TYPE_CHECKING:
    from capsule_gym.env import CapsuleEnv
    from capsule_gym.policy import Policy, load_policy, policy_names
    from capsule_gym.vector_env import CapsuleVectorEnv

__all__ = [
    "ENV_ID",
    "Capsule",
    "CapsuleEnv",
    "CapsuleVectorEnv",
    "Controller",
    "Disturbances",
    "Policy",
    "Randomization",
    "__version__",
    "load_policy",
    "policy_names",
]

__version__ = "0.1.0"

_LAZY = {
    "CapsuleEnv": ".env",
    "CapsuleVectorEnv": ".vector_env",
    "Policy": ".policy",
    "load_policy": ".policy",
    "policy_names": ".policy",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LAZY[name], __name__), name)


for _name, (_id, _steps) in TASKS.items():
    if _id not in registry:
        register(
            id=_id,
            entry_point="capsule_gym.env:CapsuleEnv",
            vector_entry_point="capsule_gym.vector_env:CapsuleVectorEnv",
            max_episode_steps=_steps,
            kwargs={} if _id == ENV_ID else {"task": _name},
        )
