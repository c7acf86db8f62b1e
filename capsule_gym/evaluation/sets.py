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
from capsule_gym.parameters.disturbances import SAMPLING
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.task import (
    CHANGE,
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
        content = {"M": self.M, "mu": self.mu, "seed": self.seed}
        content |= _changed(self, ("theta", "goal", "capsule"))
        return content | {"changes": list(self.changes)}


def batch_options(plants: Sequence[PlantSpec]) -> dict[str, list[Any]]:
    """The options of `reset` for a batch with an episode on each plant."""
    resets = [plant.reset_options() for plant in plants]
    return {key: [reset[key] for reset in resets] for key in resets[0]}


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
        return {
            "task": self.task,
            "capsule": capsule,
            **EPISODE_SETTINGS,
            "randomization": self._largest_plant(),
            "disturbances": disturbances,
        }

    def _largest_plant(self) -> Randomization:
        """Bounds M and mu for an environment that shows them; resets replace what it draws."""
        masses = [plant.M for plant in self.plants]
        frictions = [plant.mu for plant in self.plants]
        for plant in self.plants:
            masses += [change["M"] for change in plant.changes]
            frictions += [change["mu"] for change in plant.changes]
        return Randomization(M=(max(masses),) * 2, mu=(max(frictions),) * 2)

    @property
    def horizon(self) -> float:
        """The length of its episodes, s."""
        return find_task(self.task).horizon

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
        content: dict[str, Any] = {"name": self.name}
        # Older sets and their hashes lack these fields.
        content |= _changed(self, ("task", "capsule", "disturbances"))
        if self.capsule is not None:
            content["capsule"] = _changed(self.capsule, vars(self.capsule))
        if isinstance(self.disturbances, Disturbances):
            given = asdict(self.disturbances)
            for name in SAMPLING:
                del given[name]
            content["disturbances"] = given | _changed(self.disturbances, SAMPLING)
        content["plants"] = [plant.to_dict() for plant in self.plants]
        return content


def _changed(instance: Any, names: Iterable[str]) -> dict[str, Any]:
    """The fields of a dataclass, out of these, that differ from their defaults."""
    defaults = type(instance)
    values = {name: getattr(instance, name) for name in names}
    return {name: value for name, value in values.items() if value != getattr(defaults, name)}


def _check_fields(
    where: str, value: Any, required: Sequence[str], optional: Sequence[str] = ()
) -> None:
    """Checks that a value is a JSON object with these fields and no others."""
    if not isinstance(value, dict) or not set(required) <= set(value) <= {*required, *optional}:
        names = [", ".join(names) for names in (required, optional) if names]
        accepted = f"an object with the fields {' and optionally '.join(names)}"
        raise ValueError(f"{where} must be {accepted}, got {short_repr(value)}")


def _check_plant(
    where: str, value: Any, required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Any]:
    """The JSON object after a check of its fields and of M and mu, which become floats."""
    _check_fields(where, value, required, optional)
    try:
        NOMINAL.check_plant(value["M"], value["mu"])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from None
    return value | {"M": float(value["M"]), "mu": float(value["mu"])}


def _parse_plant(where: str, value: Any, task: str) -> PlantSpec:
    optional = ["theta", "changes", "capsule"]
    if task == "goal":
        optional.append("goal")
    entry = _check_plant(where, value, ("M", "mu", "seed"), optional)
    theta = entry.get("theta", START_THETA)
    largest = math.nextafter(THETA_LIMIT, 0.0)
    accepted = f"an angle in rad within {THETA_LIMIT:.4g} of 0"
    theta = check_number(f"{where}.theta", theta, accepted, -largest, largest)
    accepted = "an integer in [0, 2**128)"
    seed = check_integer(f"{where}.seed", entry["seed"], accepted, 0, 2**128 - 1)
    changes = _parse_changes(f"{where}.changes", entry.get("changes", []))
    goal = entry.get("goal")
    if goal is not None:
        farthest = LARGEST_STATE[2]
        accepted = f"a number of m within {farthest:g} of 0"
        goal = check_number(f"{where}.goal", goal, accepted, -farthest, farthest)
    capsule = entry.get("capsule")
    if capsule is not None:
        _check_fields(f"{where}.capsule", capsule, (), CONSTANTS)
        constants = {"M": entry["M"], "mu": entry["mu"], **capsule}
        from_fields(Capsule, f"{where}.capsule", constants)
    return PlantSpec(entry["M"], entry["mu"], seed, changes, theta, goal, capsule or None)


def _parse_changes(where: str, value: Any) -> tuple[dict[str, float], ...]:
    latest = math.nextafter(HORIZON, 0.0)
    accepted = f"a number of seconds within (0, {HORIZON:g})"
    changes = []
    for name, t, change in check_timed(where, value, "a list of changes", CHANGE):
        check_number(f"{name}['t']", t, accepted, 0.0, latest, open_low=True)
        changes.append(_check_plant(name, change, CHANGE) | {"t": t})
    return tuple(changes)


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
    _check_fields("set", content, ("name", "plants"), ("task", "capsule", "disturbances"))
    tasks = sorted(TASKS)
    task = check_choice("set.task", content.get("task", "speed"), tasks, f"one of {tasks}")
    name = content["name"]
    named = isinstance(name, str) and name.strip() != ""
    require(named, "set.name", "a string that is not empty", name)
    capsule = content.get("capsule")
    if capsule is not None:
        capsule = check_object("set.capsule", capsule, Capsule)
    disturbances = content.get("disturbances", "none")
    disturbances = check_object("set.disturbances", disturbances, Disturbances)
    plants = content["plants"]
    listed = isinstance(plants, list) and plants != []
    require(listed, "set.plants", "a list of at least one plant", plants)
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
    name = str(name_or_path)
    path = FOLDER / f"{name}.json" if name_or_path in names else Path(name)
    # Unlike the methods of Path, this function accepts names that no file can have.
    if not os.path.isfile(path):
        accepted = f"one of {', '.join(names)}, or the path of a JSON file"
        hint = nearest(name, names)
        raise ValueError(f"set must be {accepted}, got {short_repr(name)}{hint}")
    try:
        return parse_set(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not an evaluation set: {error}") from error
