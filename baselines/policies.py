"""The named scripted policies: a law inside the step with a zero residual, or a function of the observation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from baselines import lqr, mpc
from baselines.dynamic_programming import policy
from baselines.dynamic_programming.policy import Act
from baselines.laws import LAWS as _LAWS
from baselines.laws import TASK_LAWS, Law

Start = Callable[[Sequence[int]], Act]


def _no_action(seeds: Sequence[int]) -> Act:
    """The action 0 for every environment."""
    zeros = np.zeros((len(seeds), 1), np.float32)
    return lambda observations: zeros


@dataclass(frozen=True)
class ScriptedPolicy:
    """A policy that is not trained.

    Attributes:
        name: name in tables and on the command line.
        description: description in one line.
        env_kwargs: the arguments of `CapsuleVectorEnv` that it needs.
        start: takes the seeds of the environments and returns a function from observations (n, entries) to actions
            (n, 1), float32.
        senses: the measurements that it reads; "state" stands for theta, theta_dot and x_dot.
        told: its knowledge of the plant.
    """

    name: str
    description: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    start: Start = _no_action
    senses: str = "state"
    told: str = "nominal plant"


def _of_law(name: str, law: Law) -> ScriptedPolicy:
    """The policy that only runs a law of `baselines`."""
    env_kwargs = {"controller": f"baselines:{name}"} | ({} if law.task == "speed" else {"task": law.task})
    return ScriptedPolicy(law.policy, law.description, env_kwargs, senses=law.senses, told=law.told)


# Values of the environment's argument `controller`, by the names of the laws' policies.
LAWS = {law.policy: f"baselines:{name}" for name, law in _LAWS.items()}

SCRIPTED = {
    each.name: each
    for each in (
        *(_of_law(name, law) for name, law in _LAWS.items()),
        ScriptedPolicy("lqr", "LQR with a gain for every phase of a limit cycle of dp-nominal", {}, lqr.start),
        ScriptedPolicy("mpc", "sampling MPC on the nominal plant with the values of dp-nominal", {}, mpc.start),
        ScriptedPolicy(
            "dp-nominal",
            "dynamic programming for the nominal plant with a margin of normal force, whatever the plant",
            {},
            policy.start_nominal,
        ),
        ScriptedPolicy(
            "dp-oracle",
            "observes M and mu; dynamic programming for that plant",
            {"observe_parameters": True},
            policy.start_oracle,
            told="nominal plant, M, mu",
        ),
    )
}

# Scripted policies of the other tasks.
TASK_SCRIPTED = {law.policy: _of_law(name, law) for name, law in TASK_LAWS.items()}
ALL_SCRIPTED = {**SCRIPTED, **TASK_SCRIPTED}
