"""Compiles the package's functions for every processor type of this platform, into `capsule_gym/machine_code`."""

import shutil

import numpy as np

import baselines
from baselines.gaits import families
from baselines.laws import TASK_LAWS
from capsule_gym import Capsule, CapsuleVectorEnv, compilation, load_policy
from capsule_gym.elementary import sines_and_cosines
from capsule_gym.network import rollout
from capsule_gym.objects import LEVELS
from capsule_gym.task import TASKS

# Left by an earlier build.
shutil.rmtree(compilation.SHIPPED, ignore_errors=True)
compilation.SHIPPED.mkdir()
compilation.shipping = tuple(LEVELS)
for law in (None, *(f"baselines:{name}" for name in baselines.__all__)):
    CapsuleVectorEnv(1, controller=law).reset(seed=0)
CapsuleVectorEnv(1, capsule=Capsule(normal_force="paper")).reset(seed=0)
CapsuleVectorEnv(1, capsule=Capsule(viscous=1.0)).reset(seed=0)
for task in TASKS:
    CapsuleVectorEnv(1, task=task).reset(seed=0)
for name, law in TASK_LAWS.items():
    CapsuleVectorEnv(1, task=law.task, controller=f"baselines:{name}").reset(seed=0)
policy = load_policy("direct-ppo")
env = CapsuleVectorEnv(1, **policy.env_kwargs)
observations, _ = env.reset(seed=0)
policy(observations)
rollout(env.simulation, policy, 1)
families.actions(np.zeros((1, families.WIDTH)), 0.0, observations)
sines_and_cosines(np.zeros(1))
print(f"{len(list(compilation.SHIPPED.iterdir()))} object files in {compilation.SHIPPED}")
