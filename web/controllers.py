"""The policies that run in the browser: their names, and their environments and networks as plain numbers.

`web/data.py` packs the data of all of them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

import baselines
from baselines.policies import SCRIPTED
from capsule_gym import Policy, task
from capsule_gym.controller import Controller, find_controller
from capsule_gym.parameters import NOMINAL, EnvConfig
from capsule_gym.policy import policy_names

# The task without a law; the other names are those of laws.
DIRECT = "direct"
TASKS = (DIRECT, *baselines.__all__)
# The smallest mass of the platform with which friction up to the largest is accepted, kg.
LIGHTEST = 0.2
# Run in the browser by their recorded actions (`web.episodes`), on the frozen plants alone.
RECORDED = ("optimum-nominal", "optimum-oracle")


def is_trained(name: str) -> bool:
    """Whether a policy of the browser is a trained one."""
    return name in policy_names()


def controller_names() -> list[str]:
    """The policies that run in the browser; of a trained one the run with the lowest seed."""
    return [*SCRIPTED, *policy_names()]


@lru_cache
def find_law(name: str) -> Controller | None:
    """The law of one of `TASKS`; None for `DIRECT`."""
    return None if name == DIRECT else find_controller(f"baselines:{name}")


def task_of(options: EnvConfig) -> str:
    """Which of `TASKS` an environment has.

    Raises:
        ValueError: if its law is none of `baselines`.
    """
    if options.controller is None:
        return DIRECT
    place, _, name = str(options.controller).partition(":")
    if place != "baselines" or name not in TASKS:
        raise ValueError(f"controller must be None or a law of baselines, as in baselines:adaptive, got {place}:{name}")
    return name


def describe_settings(options: EnvConfig) -> dict[str, Any]:
    """The arguments of the compiled step for an environment, and the length of its episodes.

    Raises:
        ValueError: if it is not an environment of the paper's capsule, or its law is none of `baselines`.
    """
    # Imported here, since numba takes most of a second to import.
    from capsule_gym import layout
    from capsule_gym.observation import MU_BOUND, observation_names
    from capsule_gym.simulation import check_step, make_settings

    if options.capsule not in (None, NOMINAL):
        raise ValueError(f"options must be of the nominal capsule, got {options}")
    law = find_law(task_of(options))
    settings = make_settings(options, law)
    # For all M and mu that the page accepts.
    check_step(NOMINAL, LIGHTEST, MU_BOUND, settings)
    return {
        "fixed": layout.pack(NOMINAL.plant(), settings, np.zeros((0, 0))).tolist(),
        "entries": len(observation_names(law is not None, options.observe_parameters)),
        "control_dt": options.control_dt,
        "steps": round(task.HORIZON / options.control_dt),
    }


def describe_policy(name: str, policy: Policy) -> dict[str, Any]:
    """A trained policy as the browser runs it; its network is an array of float64.

    Args:
        name: that it has in the browser.
        policy: the policy.

    Raises:
        ValueError: as `describe_settings`, of the policy's environment.
    """
    from capsule_gym.network import HEADER

    options = EnvConfig(**policy.env_kwargs)
    network = policy._network
    return {
        "name": name,
        "task": task_of(options),
        "settings": describe_settings(options),
        "kind": "policy",
        "description": policy.description,
        "seed": policy.training_seed,
        "network": network,
        "units": int(network[HEADER : HEADER + len(policy.layers) + 1].max()),
    }
