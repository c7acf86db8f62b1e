"""Scripted policies: laws of this package with a zero residual, and policies of distributions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from operator import attrgetter
from typing import Any

import numpy as np

# Entry points by which a distribution adds policies.
GROUP = "capsule_gym.policies"

Act = Callable[[np.ndarray], np.ndarray]
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
        start: takes the seeds of the environments and returns a function from observations (n,
            entries) to actions (n, 1), float32.
        senses: the measurements that it reads; "state" stands for theta, theta_dot and x_dot.
        told: its knowledge of the plant.
    """

    name: str
    description: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    start: Start = _no_action
    senses: str = "state"
    told: str = "nominal plant"


def _law(
    law: str,
    description: str,
    told: str = "nothing",
    senses: str = "state",
    name: str = "",
    **env_kwargs: str,
) -> ScriptedPolicy:
    """The policy that only runs a law of `baselines`, by default under the law's name."""
    kwargs = {"controller": f"baselines:{law}", **env_kwargs}
    name = name or law.replace("_", "-")
    return ScriptedPolicy(name, description, kwargs, senses=senses, told=told)


_NOMINAL = "nominal plant"
_PROFILE = "the paper's profile (9)"
_FASTEST = "the fastest profile (9) with 1.5 N m"
LAW_POLICIES = {
    each.name: each
    for each in (
        _law("feedback_linearising", f"{_PROFILE}, feedback linearisation (35)", _NOMINAL),
        _law("adaptive", f"{_PROFILE}, adaptive law (39), regularised", _NOMINAL, "state, x"),
        _law(
            "adaptive_as_published",
            f"{_PROFILE}, adaptive law (39), corrected, unregularised",
            _NOMINAL,
            "state, x",
        ),
        _law(
            "adaptive_optimal_profile",
            f"{_FASTEST}, adaptive law (39), regularised",
            _NOMINAL,
            "state, x",
        ),
        _law(
            "feedback_linearising_optimal_profile",
            f"{_FASTEST} and without Principle 4, feedback linearisation (35)",
            _NOMINAL,
        ),
        _law("epc", "the EPC profile, feedback linearisation (35)", _NOMINAL),
        _law(
            "gait",
            "a gait at 1 kHz that does not observe the plant; a guard of the contact estimates M",
            "nominal pendulum",
            name="gait-guarded",
        ),
        _law(
            "gait_predictive",
            "gait-guarded on a state that an observer and a predictor of the latency give",
            _NOMINAL,
        ),
        _law(
            "open_loop",
            "torque as a function of time alone, tuned without disturbances",
            senses="nothing",
        ),
        _law(
            "open_loop_real",
            "torque as a function of time alone, tuned under disturbances",
            senses="nothing",
        ),
        _law(
            "pd",
            "PD control of the pendulum's angle along a periodic reference",
            senses="theta, theta_dot",
        ),
        _law("oscillator", "a Hopf oscillator that the state entrains"),
        _law(
            "goal_pulses",
            "gait-guarded towards the goal, then pulses that adapt; strokes on smooth floors",
            task="goal",
        ),
        _law(
            "velocity_pulses",
            "gait-guarded after the target, and pulses that adapt",
            task="velocity",
        ),
    )
}


@cache
def registered_policies() -> dict[str, EntryPoint]:
    """The policies that installed distributions add, by name.

    An entry point of the group `capsule_gym.policies` names a `ScriptedPolicy`. Those of this
    project are in `baselines.policies`.
    """
    entries = sorted(entry_points(group=GROUP), key=attrgetter("name"))
    return {entry.name: entry for entry in entries}


def scripted_names() -> list[str]:
    """The names of all scripted policies."""
    return [*LAW_POLICIES, *registered_policies()]


def find_scripted(name: str) -> ScriptedPolicy | None:
    """The scripted policy with this name, or None; loads it if another module contains it."""
    if name in LAW_POLICIES:
        return LAW_POLICIES[name]
    entry = registered_policies().get(name)
    return entry.load() if entry else None
