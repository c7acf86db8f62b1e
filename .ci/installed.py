"""Steps the installed environments with every law; fails if they come from a checkout."""

import importlib.util
from pathlib import Path

import gymnasium as gym

import capsule_gym
from capsule_gym.control.laws import LAWS, find_law
from capsule_gym.tasks.registry import TASKS

CHECKOUT = Path(__file__).parents[1].resolve()
# The environments do not need them.
OPTIONAL = ("llvmlite", "numba", "pygame", "stable_baselines3", "torch")


def step(name: str, **kwargs: str) -> None:
    """Takes one step in an environment."""
    env = gym.make(f"capsule_gym:{name}-v0", **kwargs)
    env.reset()
    env.step(env.action_space.sample())


assert not Path(capsule_gym.__file__).is_relative_to(CHECKOUT), capsule_gym.__file__
for name in OPTIONAL:
    assert importlib.util.find_spec(name) is None, f"{name} is installed"
step("CapsuleStickSlip", task="speed")
for name, law in LAWS.items():
    step("CapsuleStickSlip", task=law().task or "speed", controller=f"baselines:{name}")
for task in TASKS:
    title = task.title().replace("Speed", "StickSlip")
    step(f"Capsule{title}")
capsule_gym.load_policy("direct-ppo")
policies = [
    "direct-ppo/seed-1",
    "adaptive",
    "lqr",
    find_law("gait")(),
    lambda observations: observations[:, :1],
]
for policy in policies:
    (*_, last) = capsule_gym.evaluate(policy, "paper", horizon=0.1)
    assert last["duration"] > 0.0, policy
