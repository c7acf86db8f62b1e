"""capsule_gym: friction-driven locomotion of a capsule robot as a Gymnasium environment.

Importing the package registers `CapsuleStickSlip-v0` and the environments of the other tasks.
"""

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

from capsule_gym.control.controller import Controller
from capsule_gym.envs.env import CapsuleEnv
from capsule_gym.envs.vector_env import CapsuleVectorEnv
from capsule_gym.identification import Excitation, Fit, Sensitivity, identify, record, sensitivity
from capsule_gym.parameters import Capsule, Disturbances, Randomization
from capsule_gym.policies.loading import load_policy, policy_names
from capsule_gym.policies.policy import Policy
from capsule_gym.tasks.registry import TASKS
from capsule_gym.tasks.task import ENV_ID

if TYPE_CHECKING:
    from capsule_gym.evaluation.episodes import evaluate, summarise

__all__ = [
    "ENV_ID",
    "Capsule",
    "CapsuleEnv",
    "CapsuleVectorEnv",
    "Controller",
    "Disturbances",
    "Excitation",
    "Fit",
    "Policy",
    "Randomization",
    "Sensitivity",
    "__version__",
    "evaluate",
    "identify",
    "load_policy",
    "policy_names",
    "record",
    "sensitivity",
    "summarise",
]

__version__ = "0.1.0"

for _task in TASKS.values():
    if _task.env_id not in registry:
        register(
            id=_task.env_id,
            entry_point="capsule_gym:CapsuleEnv",
            vector_entry_point="capsule_gym:CapsuleVectorEnv",
            max_episode_steps=_task.episode_steps,
            kwargs={} if _task.env_id == ENV_ID else {"task": _task.name},
        )


def __getattr__(name: str) -> Any:
    # At the first use: importing all policies and sets would delay an environment's first step.
    if name not in ("evaluate", "summarise"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from capsule_gym.evaluation import episodes

    return getattr(episodes, name)
