"""Policies from outside: an object with `predict`, a function from observations to actions, or a folder.

`evaluate(policy, "paper")` runs any of them on the episodes that every other policy runs on; docs/your_policy.md shows
how.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.candidates import Candidate, Run, find_candidate
from agents.evaluation.episodes import Act, Episode, Policy
from agents.evaluation.episodes import evaluate as evaluate_policy
from agents.evaluation.sets import EvaluationSet, load_set
from capsule_gym.task import HORIZON

REFERENCE = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*):([A-Za-z_]\w*)")
ACCEPTED = "an object with predict() as Stable-Baselines3's have, or a function from observations to actions"


@dataclass(frozen=True)
class Outsider:
    """A policy that is not this project's.

    Attributes:
        name: as it appears in results.
        env_kwargs: the environment that it acts in; without any it commands the whole torque every 20 ms.
        begin: gives the function from observations to actions, anew for every batch of episodes.
    """

    name: str
    env_kwargs: Mapping[str, Any]
    begin: Callable[[], Callable[[np.ndarray], Any]]

    def start(self, seeds: Sequence[int]) -> Act:
        """Begins a batch of episodes; its actions are checked at every step."""
        act, shape = self.begin(), (len(seeds), 1)

        def checked(observations: np.ndarray) -> np.ndarray:
            answer = act(observations)
            accepted = f"{self.name} must return finite actions of shape {shape}, one line per observation"
            try:
                actions = np.asarray(answer, np.float32)
            except (TypeError, ValueError, RuntimeError) as error:
                raise ValueError(f"{accepted}, got {type(answer).__name__}: {error}") from error
            if actions.shape != shape or not np.isfinite(actions).all():
                raise ValueError(f"{accepted}, got {'NaN or infinity in' if actions.shape == shape else actions.shape}")
            return actions

        return checked


def adopt(policy: Any, *, name: str | None = None, env_kwargs: Mapping[str, Any] | None = None) -> Policy:
    """Makes a policy of an object.

    Args:
        policy: an object with `predict(observations, state=.., episode_start=.., deterministic=True)` that returns
            actions and the next state, as Stable-Baselines3's algorithms and policies have; or a function from
            observations (n, entries), float32, to actions (n, 1) in [-1, 1]. A policy of this project stays what it is.
        name: as it appears in results; None takes that of the function or of the object's class.
        env_kwargs: the arguments of `CapsuleVectorEnv` that it acts in; None takes its attribute `env_kwargs`, where it
            has one, else none.

    Raises:
        TypeError: if it is something else.
    """
    if hasattr(policy, "start") and hasattr(policy, "env_kwargs") and not isinstance(policy, type):
        if env_kwargs is not None:
            raise TypeError(f"env_kwargs must not be given with a policy that has its own, got {dict(env_kwargs)!r}")
        own: Policy = policy
        return own
    if isinstance(policy, type) or not (callable(policy) or hasattr(policy, "predict")):
        what = f"the class {policy.__name__}" if isinstance(policy, type) else f"a {type(policy).__name__}"
        raise TypeError(f"policy must be {ACCEPTED}, got {what}")
    begin = _predicting(policy) if callable(getattr(policy, "predict", None)) else lambda: policy
    found = getattr(policy, "env_kwargs", {}) if env_kwargs is None else env_kwargs
    own_name = getattr(policy, "__name__", type(policy).__name__)
    return Outsider(own_name if name is None else name, dict(found), begin)


def _predicting(policy: Any) -> Callable[[], Callable[[np.ndarray], Any]]:
    """What asks `predict`, and hands a recurrent policy its state back."""

    def begin() -> Callable[[np.ndarray], Any]:
        state, starts = None, True

        def act(observations: np.ndarray) -> Any:
            nonlocal state, starts
            begun = np.full(len(observations), starts)
            actions, state = policy.predict(observations, state=state, episode_start=begun, deterministic=True)
            starts = False
            return actions

        return act

    return begin


def evaluate(
    policy: Any,
    evaluation_set: EvaluationSet | str | Path = "paper",
    *,
    name: str | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    horizon: float = HORIZON,
) -> list[Episode]:
    """Runs a policy on a set, once on every plant.

    Args:
        policy: as for `adopt`; or the name or path of one, as for `agents.evaluation.candidates.find_candidate`: all
            its training seeds, one after the other.
        evaluation_set: a set, the name of a frozen one, or the path of one.
        name: as for `adopt`.
        env_kwargs: as for `adopt`.
        horizon: length of an episode in s.

    Returns:
        As `agents.evaluation.episodes.evaluate`; `agents.evaluation.episodes.summarise` sums them up.

    Raises:
        TypeError: if the policy is something else.
        ValueError: if there is no such policy or set, or the policy's actions are not what they must be.
    """
    chosen = evaluation_set if isinstance(evaluation_set, EvaluationSet) else load_set(evaluation_set)
    if isinstance(policy, (str, Path)):
        if name is not None or env_kwargs is not None:
            raise TypeError("name and env_kwargs must not be given with a policy's name or path, which has its own")
        return find_candidate(str(policy)).evaluate(chosen, horizon)
    return evaluate_policy(adopt(policy, name=name, env_kwargs=env_kwargs), chosen, horizon=horizon)


def find(name: str, *, trust: bool = False, trust_controller: bool = False) -> Candidate:
    """Finds a policy by what a command line says.

    Args:
        name: as for `find_candidate`, or "module:attribute", which is imported and adopted.
        trust: accept the latter: importing it runs its code.
        trust_controller: as for `find_candidate`.

    Raises:
        ValueError: if there is no such policy, or it is not trusted.
    """
    match = REFERENCE.fullmatch(name)
    if match is None:
        return find_candidate(name, trust_controller=trust_controller)
    if not trust:
        raise ValueError(f"policy {name!r} is code, which importing it runs: --trust accepts that")
    module_name, attribute = match.groups()
    # As for a script: what lies in the present folder is found.
    sys.path.insert(0, "")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise
        raise ValueError(f"policy {name!r} names the module {module_name!r}, which does not exist") from None
    finally:
        sys.path.remove("")
    if not hasattr(module, attribute):
        raise ValueError(f"policy {name!r}: the module {module_name!r} has no {attribute!r}")
    try:
        policy = adopt(getattr(module, attribute), name=name)
    except TypeError as error:
        raise ValueError(f"policy {name!r}: {error}") from error
    return Candidate(name, (Run(name, policy),), "a policy from outside")
