"""The named scripted policies: a law inside the step with a zero residual, a gait, or no law at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

from baselines.gaits import GAIT_DT
from baselines.laws import LAWS as _LAWS

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
class _LazyStart:
    """A `start` that is imported when it is first called: numba takes most of a second to import.

    A class, because policies are pickled.

    Attributes:
        module: of the function.
        function: its name.
    """

    module: str
    function: str

    def __call__(self, seeds: Sequence[int]) -> Act:
        start: Start = getattr(import_module(self.module), self.function)
        return start(seeds)


@dataclass(frozen=True)
class ScriptedPolicy:
    """A policy that was not learned.

    Attributes:
        name: for tables and the command line.
        description: one line.
        env_kwargs: the arguments of `CapsuleVectorEnv` that it needs.
        start: takes the seeds of the environments and returns a function from observations (n, entries) to actions
            (n, 1), float32.
    """

    name: str
    description: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    start: Start = _no_action


# Laws as the environment's argument `controller` takes them, by their policies' names.
LAWS = {law.policy: f"baselines:{name}" for name, law in _LAWS.items()}

SCRIPTED = {
    policy.name: policy
    for policy in (
        ScriptedPolicy("zero", "no torque"),
        ScriptedPolicy("random", "uniform random torque, drawn every agent step", {}, _random_actions),
        *(ScriptedPolicy(law.policy, law.description, {"controller": LAWS[law.policy]}) for law in _LAWS.values()),
        ScriptedPolicy(
            "gait-nominal",
            "the tolerant gait of the nominal plant, whatever the plant; torque every 10 ms",
            {"control_dt": GAIT_DT},
            _LazyStart("baselines.gaits.policy", "start_nominal"),
        ),
        ScriptedPolicy(
            "gait-oracle",
            "observes M and mu and takes the known gait that was fastest around such a plant; torque every 10 ms",
            {"control_dt": GAIT_DT, "observe_parameters": True},
            _LazyStart("baselines.gaits.policy", "start_oracle"),
        ),
        ScriptedPolicy(
            "optimum-nominal",
            "dynamic programming for the nominal plant with a margin of normal force, whatever the plant",
            {},
            _LazyStart("baselines.dynamic_programming.policy", "start_nominal"),
        ),
        ScriptedPolicy(
            "optimum-oracle",
            "observes M and mu; dynamic programming for that plant",
            {"observe_parameters": True},
            _LazyStart("baselines.dynamic_programming.policy", "start_oracle"),
        ),
    )
}
