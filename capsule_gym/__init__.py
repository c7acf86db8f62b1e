"""capsule_gym: friction-driven locomotion of a capsule robot as a Gymnasium environment.

Importing the package registers `CapsuleStickSlip-v0` and the environments of the other tasks.
"""

from importlib import import_module
from typing import Any

from gymnasium.envs.registration import register, registry

from capsule_gym.controller import Controller
from capsule_gym.env import CapsuleEnv
from capsule_gym.parameters import Capsule, Disturbances, Randomization
from capsule_gym.policy import Policy, load_policy, policy_names
from capsule_gym.task import ENV_ID, TASKS
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
    "evaluate",
    "load_policy",
    "policy_names",
    "summarise",
]

__version__ = "0.1.0"

for _name, (_id, _steps) in TASKS.items():
    if _id not in registry:
        register(
            id=_id,
            entry_point="capsule_gym.env:CapsuleEnv",
            vector_entry_point="capsule_gym.vector_env:CapsuleVectorEnv",
            max_episode_steps=_steps,
            kwargs={} if _id == ENV_ID else {"task": _name},
        )


def __getattr__(name: str) -> Any:
    # Imported at the first use, since the evaluation needs `baselines`, which imports this package.
    if name in ("evaluate", "summarise"):
        return getattr(import_module("baselines.evaluation.episodes"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
