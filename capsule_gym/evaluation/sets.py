"""Evaluation sets: lists of episodes on which policies are evaluated.

docs/evaluation.md describes the frozen sets.
"""

import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from capsule_gym.checks import (
    check_choice,
    check_integer,
    check_number,
    check_timed,
    from_fields,
    nearest,
    require,
    short_repr,
)
from capsule_gym.envs.config import check_object
from capsule_gym.files import canonical_hash
from capsule_gym.parameters import CONSTANTS, NOMINAL, Capsule, Disturbances, Randomization
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.task import (
    CHANGE,
    CONTROL_DT,
    HORIZON,
    LARGEST_STATE,
    START_THETA,
    THETA_LIMIT,
)

SET_NAMES = ("nominal", "paper", "wide", "extrapolation", "drift")
# Sets of the speed task with another capsule than the paper's, and of the other tasks.
FURTHER_SET_NAMES = ("sticky", "real", "real-wide")
TASK_SET_NAMES = ("goal", "goal-paper", "velocity")
# The options of an episode of a set; they override those of a policy's training.
EPISODE_SETTINGS: dict[str, Any] = {
    "randomization": "none",
    "initial_noise": 0.0,
    "initial_range": None,
}
# The frozen sets.
FOLDER = Path(__file__).parents[1] / "data" / "sets"


@dataclass(frozen=True)
class PlantSpec:
    """One episode of an evaluation set.

    Attributes:
        M: mass of the platform, kg.
        mu: friction coefficient.
        seed: seed of the episode's environment and of the policy.
        changes: changes of the plant in order of time, `{"t": s from the start, "M": kg, "mu":
            ..}`.
        theta: initial angle, at rest, rad.
        goal: displacement of the goal in the task `goal`, m; None draws it from the seed.
        capsule: further constants of this plant, out of `capsule_gym.parameters.CONSTANTS`; None
            for none.
    """

    M: float
    mu: float
    seed: int
    changes: tuple[dict[str, float], ...] = ()
    theta: float = START_THETA
    goal: float | None = None
    capsule: dict[str, float] | None = None

    def reset_options(self) -> dict[str, Any]:
        """The options of `reset` for this episode."""
        state = [self.theta, 0.0, 0.0, 0.0]
        options = {"M": self.M, "mu": self.mu, "state": state, "changes": list(self.changes)}
        return options | _changed(self, ("goal", "capsule"))

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain types."""
        given = _changed(self, ("theta", "goal", "capsule"))
        return {
            "M": self.M,
            "mu": self.mu,
            "seed": self.seed,
            **given,
            "changes": list(self.changes),
        }


NOMINAL_PLANT = PlantSpec(M=NOMINAL.M, mu=NOMINAL.mu, seed=0)


@dataclass(frozen=True)
class EvaluationSet:
    """A named list of episodes.

    Attributes:
        name: name in results.
        plants: the episodes, at least one.
        task: name of the task.
        capsule: constants of all plants; None for the default of the task.
        disturbances: the environment's argument `disturbances`; the seed of an episode determines
            what it draws.
    """

    name: str
    plants: tuple[PlantSpec, ...]
    task: str = "speed"
    capsule: Capsule | None = None
    disturbances: str | Disturbances = "none"

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment of its episodes."""
        capsule = self.capsule or find_task(self.task).defaults.get("capsule")
        disturbances = self.disturbances
        if disturbances == "none" and any(plant.capsule for plant in self.plants):
            disturbances = Disturbances(stick_threshold=0.0, x_noise=0.0)
        # An environment that shows M and mu bounds them by its randomization; resets replace what
        # it draws.
        shown = [
            each
            for plant in self.plants
            for each in ({"M": plant.M, "mu": plant.mu}, *plant.changes)
        ]
        M, mu = (max(each[name] for each in shown) for name in ("M", "mu"))
        own = {**EPISODE_SETTINGS, "randomization": Randomization(M=(M, M), mu=(mu, mu))}
        return {"task": self.task, "capsule": capsule, **own, "disturbances": disturbances}

    @property
    def horizon(self) -> float:
        """The length of its episodes, s."""
        return find_task(self.task).episode_steps * CONTROL_DT

    def check_task(self, task: str, policy: str) -> None:
        """Raises a ValueError if the task of the policy with this name is not that of the set."""
        if task != self.task:
            wanted = f"the task {self.task!r} of the set {self.name!r}"
            raise ValueError(f"policy must be for {wanted}, got {policy!r}, which is for {task!r}")

    @cached_property
    def hash(self) -> str:
        """The sha256 of the content in canonical JSON; the file's layout does not matter."""
        return canonical_hash(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The content of the set's file."""
        # Older sets and their hashes lack these fields.
        options = _changed(self, ("task", "capsule", "disturbances"))
        if self.capsule is not None:
            options["capsule"] = _changed(self.capsule, vars(self.capsule))
        if isinstance(self.disturbances, Disturbances):
            options["disturbances"] = asdict(self.disturbances)
        return {"name": self.name, **options, "plants": [plant.to_dict() for plant in self.plants]}


def _changed(instance: Any, names: Iterable[str]) -> dict[str, Any]:
    """The fields of a dataclass, out of these, that differ from their defaults."""
    return {
        name: value
        for name in names
        if (value := getattr(instance, name)) != getattr(type(instance), name)
    }


def _fields(
    where: str, value: Any, required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Any]:
    """The JSON object, after a check that it has these fields and no others, and of M and mu where
    it has them.
    """
    if not isinstance(value, dict) or not set(required) <= set(value) <= {*required, *optional}:
        accepted = " and optionally ".join(
            ", ".join(names) for names in (required, optional) if names
        )
        raise ValueError(
            f"{where} must be an object with the fields {accepted}, got {short_repr(value)}"
        )
    if "M" not in required:
        return value
    try:
        NOMINAL.check_plant(value["M"], value["mu"])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from None
    return {**value, "M": float(value["M"]), "mu": float(value["mu"])}


def _parse_plant(where: str, value: Any, task: str) -> PlantSpec:
    optional = ("theta", "changes", "capsule", *(("goal",) if task == "goal" else ()))
    entry = _fields(where, value, ("M", "mu", "seed"), optional)
    largest, accepted = (
        math.nextafter(THETA_LIMIT, 0.0),
        f"an angle in rad within {THETA_LIMIT:.4g} of 0",
    )
    theta = check_number(
        f"{where}.theta", entry.get("theta", START_THETA), accepted, -largest, largest
    )
    seed = check_integer(f"{where}.seed", entry["seed"], "an integer in [0, 2**128)", 0, 2**128 - 1)
    changes, accepted = [], f"a number of seconds within (0, {HORIZON:g})"
    for name, t, change in check_timed(
        f"{where}.changes", entry.get("changes", []), "a list of changes", CHANGE
    ):
        check_number(f"{name}['t']", t, accepted, 0.0, math.nextafter(HORIZON, 0.0), open_low=True)
        changes.append({**_fields(name, change, CHANGE), "t": t})
    goal, farthest = entry.get("goal"), LARGEST_STATE[2]
    if goal is not None:
        goal = check_number(
            f"{where}.goal", goal, f"a number of m within {farthest:g} of 0", -farthest, farthest
        )
    capsule = entry.get("capsule")
    if capsule is not None:
        _fields(f"{where}.capsule", capsule, (), CONSTANTS)
        from_fields(Capsule, f"{where}.capsule", {"M": entry["M"], "mu": entry["mu"], **capsule})
    return PlantSpec(entry["M"], entry["mu"], seed, tuple(changes), theta, goal, capsule or None)


def parse_set(content: Any) -> EvaluationSet:
    """Validates the parsed JSON of a set.

    Args:
        content: `{"name": .., "plants": [..]}`, optionally with the other fields of an
            `EvaluationSet`, such as `"capsule": {"static_ratio": 1.3}` and `"disturbances":
            {"latency": [0.005, 0.015]}`. A plant is an object with M, mu, seed and optionally the
            other fields of a `PlantSpec`; all or none have a goal, and their capsules have
            constants of the same names.

    Raises:
        TypeError: if a number is of the wrong type.
        ValueError: if anything else is malformed; the message names the field, its value and the
            accepted values.
    """
    entry = _fields("set", content, ("name", "plants"), ("task", "capsule", "disturbances"))
    task = check_choice(
        "set.task", entry.get("task", "speed"), sorted(TASKS), f"one of {sorted(TASKS)}"
    )
    name, capsule, plants = entry["name"], entry.get("capsule"), entry["plants"]
    require(
        isinstance(name, str) and name.strip() != "", "set.name", "a string that is not empty", name
    )
    if capsule is not None:
        capsule = check_object("set.capsule", capsule, Capsule)
    disturbances = check_object("set.disturbances", entry.get("disturbances", "none"), Disturbances)
    require(
        isinstance(plants, list) and plants != [],
        "set.plants",
        "a list of at least one plant",
        plants,
    )
    parsed = tuple(_parse_plant(f"set.plants[{i}]", plant, task) for i, plant in enumerate(plants))
    if len({plant.goal is None for plant in parsed}) > 1:
        raise ValueError("set.plants must have a goal each, or none must have one")
    if len({tuple(plant.capsule or ()) for plant in parsed}) > 1:
        raise ValueError(
            "set.plants must each have a capsule with the same constants, or none must have one"
        )
    return EvaluationSet(name, parsed, task, capsule, disturbances)


def load_set(name_or_path: str | Path) -> EvaluationSet:
    """Loads an evaluation set.

    Args:
        name_or_path: the name of a frozen set, or the path of a JSON file of the same form (see
            `parse_set`).

    Raises:
        ValueError: if there is no such set, or its file is malformed.
    """
    names = SET_NAMES + FURTHER_SET_NAMES + TASK_SET_NAMES
    path = FOLDER / f"{name_or_path}.json" if name_or_path in names else Path(str(name_or_path))
    # Unlike the methods of Path, this function accepts names that no file can have.
    if not os.path.isfile(path):
        raise ValueError(
            f"set must be one of {', '.join(names)}, or the path of a JSON file, got {short_repr(str(name_or_path))}"
            f"{nearest(str(name_or_path), names)}"
        )
    try:
        return parse_set(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not an evaluation set: {error}") from error
