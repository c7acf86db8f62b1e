"""The named scripted policies: a law inside the step with a zero residual, a gait, or no law at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from baselines import lqr, mpc
from baselines.dynamic_programming import policy
from baselines.gaits import GAIT_DT, archive
from baselines.laws import LAWS as _LAWS
from baselines.laws import TASK_LAWS

Act = Callable[[np.ndarray], np.ndarray]
Start = Callable[[Sequence[int]], Act]


def _no_action(seeds: Sequence[int]) -> Act:
    """The action 0 for every environment."""
    zeros = np.zeros((len(seeds), 1), np.float32)
    return lambda observations: zeros


def _random_actions(seeds: Sequence[int]) -> Act:
    """Uniform actions; each environment has its own generator, so that its episode depends on its seed alone."""
    generators = [np.random.default_rng([seed, 1]) for seed in seeds]
    return lambda observations: np.array([[rng.uniform(-1.0, 1.0)] for rng in generators], np.float32)


@dataclass(frozen=True)
class ScriptedPolicy:
    """A policy that is not trained.

    Attributes:
        name: name in tables and on the command line.
        description: description in one line.
        env_kwargs: the arguments of `CapsuleVectorEnv` that it needs.
        start: takes the seeds of the environments and returns a function from observations (n, entries) to actions
            (n, 1), float32.
        senses: the entries of the state that it reads.
        told: its knowledge of the plant.
    """

    name: str
    description: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    start: Start = _no_action
    senses: str = ""
    told: str = "nothing"


# Values of the environment's argument `controller`, by the names of the laws' policies.
LAWS = {law.policy: f"baselines:{name}" for name, law in _LAWS.items()}

SCRIPTED = {
    each.name: each
    for each in (
        ScriptedPolicy("zero", "no torque"),
        ScriptedPolicy("random", "uniform random torque, drawn every agent step", {}, _random_actions),
        *(ScriptedPolicy(law.policy, law.description, {"controller": LAWS[law.policy]}) for law in _LAWS.values()),
        ScriptedPolicy(
            "gait-nominal",
            "the tolerant gait of the nominal plant, whatever the plant; torque every 10 ms",
            {"control_dt": GAIT_DT},
            archive.start_nominal,
        ),
        ScriptedPolicy(
            "gait-oracle",
            "observes M and mu and takes the known gait that was fastest around such a plant; torque every 10 ms",
            {"control_dt": GAIT_DT, "observe_parameters": True},
            archive.start_oracle,
        ),
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
        ),
    )
}

# Scripted policies of the other tasks.
TASK_SCRIPTED = {
    law.policy: ScriptedPolicy(law.policy, law.description, {"task": law.task, "controller": f"baselines:{name}"})
    for name, law in TASK_LAWS.items()
}
ALL_SCRIPTED = {**SCRIPTED, **TASK_SCRIPTED}
