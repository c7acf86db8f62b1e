"""The named scripted policies: a law inside the step with a zero residual, a gait, or no law at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

from baselines.gaits import GAIT_DT

Act = Callable[[np.ndarray], np.ndarray]
Start = Callable[[Sequence[int]], Act]
GAIT: dict[str, Any] = {"control_dt": GAIT_DT}
PERFORMANCE, OPTIMUM = "baselines.gaits.policy", "baselines.dynamic_programming.policy"


def _no_action(seeds: Sequence[int]) -> Act:
    """The action 0 for every environment."""
    zeros = np.zeros((len(seeds), 1), np.float32)
    return lambda observations: zeros


def _random_actions(seeds: Sequence[int]) -> Act:
    """Uniform actions; each environment has a generator of its own, so that its episode depends on its seed alone."""
    generators = [np.random.default_rng([seed, 1]) for seed in seeds]
    return lambda observations: np.array([[rng.uniform(-1.0, 1.0)] for rng in generators], np.float32)


@dataclass(frozen=True)
class _Later:
    """A `start` that is imported when it is first called: numba, which comes with it, takes most of a second.

    A class, because a policy goes to other processes.

    Attributes:
        module: where it is.
        function: its name there.
    """

    module: str
    function: str

    def __call__(self, seeds: Sequence[int]) -> Act:
        start: Start = getattr(import_module(self.module), self.function)
        return start(seeds)


@dataclass(frozen=True)
class ScriptedPolicy:
    """A policy that was not learnt.

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


def _with_law(name: str, attribute: str, description: str) -> ScriptedPolicy:
    """A law of this package with a zero residual."""
    return ScriptedPolicy(name, description, {"controller": f"baselines:{attribute}"})


SCRIPTED = {
    policy.name: policy
    for policy in (
        ScriptedPolicy("zero", "no torque"),
        ScriptedPolicy("random", "uniform random torque, drawn every agent step", {}, _random_actions),
        _with_law(
            "feedback-linearising", "feedback_linearising", "the paper's profile (9), feedback linearisation (35)"
        ),
        _with_law("adaptive", "adaptive", "the paper's profile (9), adaptive law (39), regularised"),
        _with_law(
            "adaptive-as-published",
            "adaptive_as_published",
            "the paper's profile (9), adaptive law (39), corrected, unregularised",
        ),
        _with_law("compliant", "compliant", "the paper's profile (9), adaptive law (39) with low gains"),
        _with_law("epc", "epc", "the EPC profile, feedback linearisation (35)"),
        _with_law(
            "gait-guarded", "gait", "a gait at 1 kHz that is told nothing of the plant, with a guard of the contact"
        ),
        _with_law(
            "gait-identifying", "gait_identifying", "gait-guarded, whose guard identifies how light the platform is"
        ),
        ScriptedPolicy(
            "gait-nominal",
            "the tolerant gait of the nominal plant, whatever the plant; torque every 10 ms",
            GAIT,
            _Later(PERFORMANCE, "start_nominal"),
        ),
        ScriptedPolicy(
            "gait-oracle",
            "sees M and mu and takes the known gait that proved fastest around such a plant; torque every 10 ms",
            {**GAIT, "observe_parameters": True},
            _Later(PERFORMANCE, "start_oracle"),
        ),
        ScriptedPolicy(
            "optimum-nominal",
            "the optimum of the nominal plant that spares some contact, whatever the plant; looks one hold ahead",
            {},
            _Later(OPTIMUM, "start_nominal"),
        ),
        ScriptedPolicy(
            "optimum-oracle",
            "sees M and mu and takes the torque of the optimum there; looks one hold ahead",
            {"observe_parameters": True},
            _Later(OPTIMUM, "start_oracle"),
        ),
    )
}
# Laws that act alone, as the environment's argument `controller` takes them, by their policies' names.
LAWS: dict[str, str] = {
    name: policy.env_kwargs["controller"]
    for name, policy in SCRIPTED.items()
    if policy.start is _no_action and "controller" in policy.env_kwargs
}
