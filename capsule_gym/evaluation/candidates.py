"""Policies by name or path: scripted policies, checkpoints, runs, policies of other projects.

docs/evaluation.md shows how to evaluate the latter.
"""

import inspect
import os
import pkgutil
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from gymnasium.spaces import Dict

from capsule_gym.checks import nearest, short_repr
from capsule_gym.control.controller import Controller
from capsule_gym.envs.config import EnvConfig
from capsule_gym.policies.loading import FOLDER, load_policy
from capsule_gym.policies.policy import Policy
from capsule_gym.policies.scripted import (
    LAW_POLICIES,
    Act,
    ScriptedPolicy,
    Start,
    find_scripted,
    scripted_names,
)

# The paper's controller, the reference of all comparisons.
BASELINE = "adaptive"
CHECKPOINTS = FOLDER
REFERENCE = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*):([A-Za-z_]\w*)")
NO_POSITION = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD)
EXTERNAL = "a policy of another project"


class AnyPolicy(Protocol):
    """Policies that can be evaluated, scripted and trained."""

    @property
    def name(self) -> str:
        """The name in results."""

    @property
    def env_kwargs(self) -> Mapping[str, Any]:
        """The arguments of the policy's `CapsuleVectorEnv`, without `EPISODE_SETTINGS`."""

    def start(self, seeds: Sequence[int], /) -> Act:
        """Starts a batch of episodes, each with a seed for policies that draw random numbers.

        Returns:
            A function from observations (episodes, entries) to actions (episodes, 1), float32, for
            every agent step.
        """


def wrap_policy(
    policy: Any, *, name: str | None = None, env_kwargs: Mapping[str, Any] | None = None
) -> AnyPolicy:
    """Wraps an object of another project as a policy; returns a policy of this project unchanged.

    Args:
        policy: an object with `predict` of Stable-Baselines3's algorithms and policies; an object
            with `start` of `Policy`; a function from observations (n, entries), float32, to actions
            (n, 1) in [-1, 1]; or a `Controller`, a control law that acts alone.
        name: name in results; None takes the attribute of the object or the name of its class.
        env_kwargs: arguments of the policy's `CapsuleVectorEnv`; None takes the attribute of the
            object, if any.

    Raises:
        TypeError: if the policy is of another type, or `env_kwargs` is given for a policy that has
            its own.
    """
    start = None if isinstance(policy, type) else getattr(policy, "start", None)
    if callable(start) and hasattr(policy, "env_kwargs"):
        if env_kwargs is not None:
            own = f"a policy that has its own, got {dict(env_kwargs)!r}"
            raise TypeError(f"env_kwargs must not be given with {own}")
        return policy
    if env_kwargs is None:
        env_kwargs = getattr(policy, "env_kwargs", {})
    kwargs = dict(env_kwargs)
    if name is None:
        name = getattr(policy, "__name__", type(policy).__name__)
        name = getattr(policy, "name", name)
    if isinstance(policy, Controller):
        if policy.task:
            kwargs.setdefault("task", getattr(policy.task, "name", policy.task))
        kwargs["controller"] = policy
        return ScriptedPolicy(name, EXTERNAL, kwargs)
    if not callable(start):
        start = _start_of(policy)
    return ScriptedPolicy(name, EXTERNAL, kwargs, start)


def _start_of(policy: Any) -> Start:
    """The attribute `start` of a policy that has none."""
    is_class = isinstance(policy, type)
    if is_class or not (callable(policy) or hasattr(policy, "predict")):
        got = f"the class {policy.__name__}" if is_class else f"a {type(policy).__name__}"
        raise TypeError(
            "policy must be an object with predict(), as of Stable-Baselines3, or start(), a "
            f"Controller, or a function of observations, got {got}"
        )
    if callable(getattr(policy, "predict", None)):
        return _start_with_predict(policy)
    if inspect.isfunction(policy) and not _takes_observations(policy):
        name = policy.__name__
        raise TypeError(
            f"policy must be a function of observations, got {name}, which needs no argument: "
            f"{name}() may be what you mean"
        )
    return lambda seeds: policy


def _takes_observations(function: Any) -> bool:
    """Whether a function has an argument without a default, or takes any number of them."""
    for parameter in inspect.signature(function).parameters.values():
        optional = parameter.default is not parameter.empty or parameter.kind in NO_POSITION
        if not optional:
            return True
    return False


def _start_with_predict(policy: Any) -> Start:
    """Calls `predict`, and passes a recurrent policy its state."""
    space = getattr(policy, "observation_space", None)

    def start(seeds: Sequence[int]) -> Act:
        state: Any = None
        starts = np.ones(len(seeds), bool)

        def act(observations: np.ndarray) -> np.ndarray:
            nonlocal state, starts
            if isinstance(space, Dict) and not isinstance(observations, dict):
                shown = f"what its environment shows, arrays, got a model of {space}"
                raise ValueError(f"policy must observe {shown}")
            actions, state = policy.predict(
                observations, state=state, episode_start=starts, deterministic=True
            )
            starts = np.zeros(len(seeds), bool)
            return np.asarray(actions)

        return act

    return start


@dataclass(frozen=True)
class Candidate:
    """A named policy with all its training seeds.

    Attributes:
        name: name in results.
        policies: one policy per training seed, in order of the seed; a single one for a scripted
            policy.
        description: one sentence for tables.
        folder: the folder of the checkpoint; None for a scripted policy.
    """

    name: str
    policies: tuple[AnyPolicy, ...]
    description: str
    folder: Path | None = None

    @property
    def task(self) -> str:
        """The task of the policies."""
        return str(self.policies[0].env_kwargs.get("task", "speed"))

    @property
    def trained(self) -> list[Policy]:
        """The policies that come from training runs; empty for a scripted policy."""
        return [policy for policy in self.policies if isinstance(policy, Policy)]

    @property
    def base(self) -> str | None:
        """The scripted policy that only runs the law of the trained policies, or None."""
        alone = {"controller": self.policies[0].env_kwargs.get("controller")}
        names = (name for name, policy in LAW_POLICIES.items() if policy.env_kwargs == alone)
        return next(names, None) if self.trained else None

    @property
    def inputs(self) -> tuple[str, str]:
        """What the policies sense, and what they are told about the plant."""
        if not self.trained:
            policy = self.policies[0]
            return getattr(policy, "senses", ""), getattr(policy, "told", "")
        options = EnvConfig(**self.trained[0].env_kwargs)
        senses = "state, stick"
        told = "nothing"
        if self.trained[0].cell:
            senses += " of all steps"
        elif options.stack_size > 1:
            senses += f" of {options.stack_size} steps"
        if self.base:
            senses += ", law"
            told = LAW_POLICIES[self.base].told
        if options.observe_estimates:
            # The estimates follow from a model of the pendulum.
            senses += ", estimates of M, mu"
            told = "nominal pendulum"
        if options.observe_parameters:
            told = "M, mu"
        return senses, told


def _trained(name: str, folder: Path, trust_controller: bool = False) -> Candidate:
    """Loads a trained policy from a folder with runs, from a run's folder or from a file."""
    paths = [path for path in sorted(folder.glob("seed-*")) if path.is_dir()] or [folder]
    loaded = [load_policy(path, trust_controller=trust_controller) for path in paths]
    seeds = [policy.training_seed for policy in loaded]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"{folder} must contain runs of different training seeds, got {seeds}")
    descriptions = {policy.description for policy in loaded}
    if len(descriptions) > 1:
        kinds = "; ".join(sorted(descriptions))
        raise ValueError(f"{folder} must contain runs of one kind, got: {kinds}")
    loaded.sort(key=lambda policy: policy.training_seed)
    return Candidate(name, tuple(loaded), descriptions.pop(), folder)


def checkpoint_names() -> list[str]:
    """The names of the committed checkpoints."""
    return sorted(path.name for path in CHECKPOINTS.glob("*") if path.is_dir())


def find_candidate(
    name_or_path: str, *, trust: bool = False, trust_controller: bool = False
) -> Candidate:
    """Finds a policy.

    Args:
        name_or_path: a scripted policy; a checkpoint with all its training seeds, or one of its
            runs as NAME/seed-0; a folder with runs seed-0, seed-1, .. inside; a run's folder or a
            policy file; or "module:attribute", which is imported and passed to `wrap_policy`.
        trust: accept "module:attribute": importing it runs its code.
        trust_controller: as for `capsule_gym.load_policy`.

    Raises:
        ValueError: if the policy does not exist, its folder is incomplete, or the policy or its law
            is not trusted.
    """
    if REFERENCE.fullmatch(name_or_path):
        if not trust:
            risk = f"importing policy {name_or_path!r} runs its code"
            raise ValueError(f"{risk}; --trust allows it, or pass the object")
        return _imported(name_or_path)
    policy = find_scripted(name_or_path)
    if policy is not None:
        return Candidate(name_or_path, (policy,), policy.description)
    known = name_or_path.partition("/")[0] in checkpoint_names()
    path = CHECKPOINTS / name_or_path if known else Path(name_or_path)
    # Unlike the methods of Path, this function accepts names that no file can have.
    if os.path.exists(path):
        return _trained(name_or_path, path, trust_controller)
    scripted = scripted_names()
    checkpoints = checkpoint_names()
    hint = nearest(name_or_path, scripted + checkpoints)
    raise ValueError(
        f"policy must be a scripted policy ({', '.join(scripted) or 'there is none'}), a "
        f"checkpoint ({', '.join(checkpoints) or 'there is none'}), or the path of a run's folder "
        f"or of a policy file, got {short_repr(name_or_path)}{hint}"
    )


def _imported(name: str) -> Candidate:
    """The object "module:attribute" as a policy; importing it runs its code."""
    # Finds modules in the current folder, as for a script.
    sys.path.insert(0, "")
    try:
        found = pkgutil.resolve_name(name)
    except (ModuleNotFoundError, AttributeError) as error:
        raise ValueError(f"policy {name!r} cannot be imported: {error}") from error
    finally:
        sys.path.remove("")
    try:
        return Candidate(name, (wrap_policy(found, name=name),), EXTERNAL)
    except TypeError as error:
        raise ValueError(f"policy {name!r}: {error}") from error
