"""Steps the installed environments with every control law; fails if they come from a checkout or
need numba.
"""

import importlib.util
from pathlib import Path

import gymnasium as gym

import capsule_gym
from capsule_gym.control.laws import LAWS, find_law
from capsule_gym.tasks.registry import TASKS

assert not Path(capsule_gym.__file__).is_relative_to(Path(__file__).parents[1].resolve()), (
    capsule_gym.__file__
)
for name in ("llvmlite", "numba", "pygame", "stable_baselines3", "torch"):
    assert importlib.util.find_spec(name) is None, f"{name} is installed"
laws = [("speed", None), *((law().task or "speed", name) for name, law in LAWS.items())]
for task, law in laws:
    env = gym.make(
        "capsule_gym:CapsuleStickSlip-v0", task=task, controller=law and f"baselines:{law}"
    )
    env.reset()
    env.step(env.action_space.sample())
for task in TASKS:
    env = gym.make(f"capsule_gym:Capsule{task.title().replace('Speed', 'StickSlip')}-v0")
    env.reset()
    env.step(env.action_space.sample())
capsule_gym.load_policy("direct-ppo")
for policy in (
    "direct-ppo/seed-1",
    "adaptive",
    "lqr",
    find_law("gait")(),
    lambda observations: observations[:, :1],
):
    (*_, last) = capsule_gym.evaluate(policy, "paper", horizon=0.1)
    assert last["duration"] > 0.0, policy
