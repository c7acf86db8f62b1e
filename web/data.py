"""Data for the JavaScript: modules, drivers, settings, tables, networks, plants and episodes.

All data are in one archive: the length of a header in four bytes, the header as JSON, and the content, whose positions
are in the header. Float64 arrays are stored column by column; for each column, the lowest bytes of all numbers come
first, then the next bytes. Neighbouring bytes are then similar, which reduces the compressed size by a third.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from typing import Any

import numpy as np

from baselines.dynamic_programming.policy import TORQUES
from baselines.gaits.archive import GaitMap, encode_gaits, known_gaits, tolerant_nominal
from baselines.policies import ALL_SCRIPTED
from capsule_gym import Policy, load_policy, resets, task
from capsule_gym.config import LARGEST_STACK, EnvConfig, find_task
from capsule_gym.evaluation_sets import FURTHER_SET_NAMES, SET_NAMES, TASK_SET_NAMES, EvaluationSet, load_set
from capsule_gym.layout import HISTORY_ROWS, LANES, SETTINGS, Row, StepSettings, pack
from capsule_gym.network import HEADER, Header
from capsule_gym.observation import CELLS, M_BOUND, MU_BOUND, observation_names
from capsule_gym.parameters import (
    CONSTANTS,
    DISTURBANCES,
    NOMINAL,
    RANDOMIZATIONS,
    REAL,
    Capsule,
    Disturbances,
    Plant,
    Randomization,
)
from capsule_gym.settings import NO_CONTROLLER, check_step, count_rows, make_settings
from capsule_gym.simulation import LARGEST_KEY
from web.episodes import FILE, OVER, RECORDED, SEEDS, controller_names, env_kwargs, is_trained, known_recordings
from web.modules import COMMON, DIRECT, ENTRIES, LAWS, STARTS, STEPS, build, find_law

# Smallest accepted mass of the platform, kg, at which the largest friction is also accepted; and largest friction of
# the motor, N m, for the capsule and for disturbances.
LIGHTEST, LARGEST_MOTOR_FRICTION = 0.2, 0.2
# Accepted values of the other constants.
RANGES = Randomization(
    M=(LIGHTEST, M_BOUND * NOMINAL.M),
    mu=(0.0, MU_BOUND),
    m=(0.1, 0.18),
    l=(0.25, 0.35),
    g=(1.0, 15.0),
    k=(0.2, 0.6),
    c=(0.05, 0.15),
    static_ratio=(1.0, 1.5),
    backward_ratio=(0.5, 1.5),
    viscous=(0.0, 2.0),
    stribeck_speed=(0.02, 1.0),
    slope=(-0.2, 0.2),
    motor_friction=(0.0, LARGEST_MOTOR_FRICTION),
)
GAITS: dict[str, Callable[[], GaitMap]] = {
    "gait-nominal": lambda: GaitMap((NOMINAL.M,), (NOMINAL.mu,), (tolerant_nominal(),), ((0,),)),
    "gait-oracle": lambda: known_gaits().oracle,
}
RANDOM = "random"
# Range of energy weights (cm/J) in the training of the policy that observes its weight.
TRAINED_WEIGHTS = (0.1, 20.0)


class Archive:
    """Arrays and bytes; equal contents are stored once."""

    def __init__(self) -> None:
        self._content = b""
        self._known: dict[tuple[str, bytes], dict[str, int]] = {}

    def add(self, content: bytes) -> dict[str, int]:
        """Stores bytes; returns their entry in the header."""
        return self._keep("bytes", content, {"size": len(content)})

    def add_array(self, array: np.ndarray) -> dict[str, int]:
        """Stores a float64 array of one or two dimensions; returns its entry in the header."""
        table = np.ascontiguousarray(array, "<f8").reshape(len(array), -1)
        rows, columns = table.shape
        content = table.view(np.uint8).reshape(rows, columns, 8).transpose(1, 2, 0).tobytes()
        return self._keep(f"{rows} {columns}", content, {"rows": rows, "columns": columns})

    def _keep(self, kind: str, content: bytes, place: dict[str, int]) -> dict[str, int]:
        key = kind, content
        if key not in self._known:
            self._known[key] = {"at": len(self._content), **place}
            self._content += content
        return self._known[key]

    def pack(self, header: dict[str, Any]) -> str:
        """The header and the content, compressed with zlib, in base64."""
        text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
        return base64.b64encode(zlib.compress(len(text).to_bytes(4, "little") + text + self._content, 9)).decode()


def pack_data() -> str:
    """The archive with all data for the JavaScript."""
    archive, modules = Archive(), build([COMMON, *STEPS, *LAWS])
    return archive.pack(
        {
            "modules": {name: archive.add(content) for name, content in modules.items()},
            "layout": layout(),
            "tasks": {name: describe_task(name) for name in task.TASKS},
            "variation": variation(),
            "controllers": {name: describe_controller(name, archive) for name in LAWS},
            "drivers": [describe_driver(name, archive) for name in controller_names()],
            "sets": {
                each.name: describe_set(each)
                for each in map(load_set, (*SET_NAMES, *FURTHER_SET_NAMES, *TASK_SET_NAMES))
            },
            "constants": constants(),
            "episodes": json.loads(FILE.read_text(encoding="utf-8")),
        }
    )


def layout() -> dict[str, Any]:
    """The layout of the arrays that the modules take."""
    return {
        "lanes": LANES,
        "quantities": Row._fields,
        "starts": STARTS,
        "most_entries": ENTRIES * LARGEST_STACK,
        "cells": CELLS,
        "history_rows": HISTORY_ROWS,
        "plant": {name: place for place, name in enumerate(Plant._fields)},
        "settings": {name: SETTINGS + place for place, name in enumerate(StepSettings._fields)},
        "log_energy_weight": Header._fields.index("log_energy_weight"),
        "torques": TORQUES.tolist(),
        "terminations": [termination.name for termination in task.Termination],
    }


def describe_task(name: str) -> dict[str, Any]:
    """A task: the rows of its memory, the values shown in `info`, and the draws at a reset."""
    own = find_task(name)
    return {
        "memory": own.memory._fields,
        "term": own.term,
        "shown": own.shown,
        "options": list(own.options),
        "table": resets.draw_table(own.rows - len(own.draws), resets.Stream.task, own.draws).tolist(),
    }


def variation() -> dict[str, Any]:
    """The constants that a varied plant draws, and their accepted values."""
    draws = [task.Draw(0.0, 0.0)] * (len(CONSTANTS) + len(DISTURBANCES)) + [task.Draw(0.0, LARGEST_KEY)]
    limits = {name: Disturbances.limits(name) for name in DISTURBANCES}
    return {
        "constants": CONSTANTS,
        "disturbances": DISTURBANCES,
        "table": resets.draw_table(Row.drawn_m, resets.Stream.variation, draws).tolist(),
        "limits": {**limits, "motor_friction": (0.0, LARGEST_MOTOR_FRICTION)},
        "ideal": asdict(Disturbances()),
    }


def describe_controller(name: str, archive: Archive) -> dict[str, Any]:
    """A law, its reference table, and the settings of the step for each of its tasks."""
    law = find_law(name)
    acting = law or NO_CONTROLLER
    tasks = [acting.task] if acting.task else list(task.TASKS)
    controller = f"baselines:{name}" if law else None
    return {
        "rows": count_rows(law),
        "memory": acting.memory,
        "table": archive.add_array(acting.reference),
        "settings": {each: describe_settings(EnvConfig(controller=controller, task=each)) for each in tasks},
    }


def controller_of(options: EnvConfig) -> str:
    """The name of an environment's law in `LAWS`.

    Raises:
        ValueError: if the law is not from `baselines`.
    """
    if options.controller is None:
        return DIRECT
    place, _, name = str(options.controller).partition(":")
    if place != "baselines" or name not in LAWS:
        raise ValueError(f"controller must be None or a law of baselines, as in baselines:adaptive, got {place}:{name}")
    return name


@cache
def _corners(capsule: Capsule) -> list[Capsule]:
    """The stiffest plants that the page accepts, including the motor friction of disturbances."""
    return list(replace(RANGES, motor_friction=(0.0, 2.0 * LARGEST_MOTOR_FRICTION)).corners(capsule))


def describe_settings(options: EnvConfig) -> dict[str, Any]:
    """The arguments of the compiled step for an environment, plain and varied, and the length of its episodes.

    Raises:
        ValueError: if the capsule needs the varied step, or the law is not from `baselines`.
    """
    capsule, own, law = options.capsule or NOMINAL, find_task(options.task), find_law(controller_of(options))
    plant = capsule.plant()
    if plant.extended or plant.pivot_torque_on_contact:
        raise ValueError(f"options must be of a level floor with Coulomb's friction and Newton's force, got {options}")
    fixed = {}
    for name, disturbed in (("fixed", "none"), ("varied", Disturbances())):
        settings = make_settings(replace(options, randomization="none", disturbances=disturbed), law)
        # The step must be valid for all plants that the page accepts.
        for corner in _corners(capsule):
            check_step(corner, corner.M, corner.mu, settings)
        fixed[name] = pack(plant, settings, np.zeros((0, 0))).tolist()
    given = options.disturbances
    return {
        **fixed,
        "capsule": [getattr(capsule, name) for name in CONSTANTS],
        "disturbances": asdict(given) if isinstance(given, Disturbances) else given,
        "entries": len(observation_names(law is not None, options.observe_parameters, own.entries, options.stack_size)),
        "control_dt": options.control_dt,
        "steps": round(own.episode_steps * task.CONTROL_DT / options.control_dt),
    }


def describe_policy(name: str, policy: Policy) -> dict[str, Any]:
    """The description of a trained policy for the browser; the network is a float64 array.

    Raises:
        ValueError: as in `describe_settings`, for the policy's environment.
    """
    options = EnvConfig(**policy.env_kwargs)
    network = policy._network
    return {
        "name": name,
        "task": find_task(options.task).name,
        "controller": controller_of(options),
        "settings": describe_settings(options),
        "kind": "policy",
        "description": policy.description,
        "seed": policy.training_seed,
        "network": network,
        "units": int(network[HEADER : HEADER + len(policy.layers) + 1].max()),
    }


def describe_driver(name: str, archive: Archive) -> dict[str, Any]:
    """The description of a driver for the page and the step; a trained policy is the run with the lowest seed."""
    if is_trained(name):
        policy = load_policy(name)
        described = describe_policy(name, policy)
        network = archive.add_array(described["network"])
        weights = {"energyWeight": TRAINED_WEIGHTS} if policy.observes_energy_weight else {}
        return {**described, **weights, "network": network}
    options = EnvConfig(**env_kwargs(name))
    described = {
        "name": name,
        "task": find_task(options.task).name,
        "controller": controller_of(options),
        "settings": describe_settings(options),
        "description": ALL_SCRIPTED[name].description,
    }
    if name in GAITS:
        found = GAITS[name]()
        place = {"M": found.M, "edges": found.edges().tolist(), "cells": found.cells}
        return {**described, "kind": "gait", "gaits": {**place, "table": archive.add_array(encode_gaits(found.gaits))}}
    if name in RECORDED:
        recordings = {
            each: {**archive.add(places[places != OVER].tobytes()), "steps": (places != OVER).sum(axis=1).tolist()}
            for each, places in known_recordings()[name].items()
        }
        return {**described, "kind": "recording", "recordings": recordings}
    if name == RANDOM:
        # State and increment of each seed's generator, 16 bytes each.
        states = [np.random.default_rng([seed, 1]).bit_generator.state["state"] for seed in range(SEEDS)]
        content = b"".join(each[key].to_bytes(16, "little") for each in states for key in ("state", "inc"))
        return {**described, "kind": "none", "seeds": {**archive.add(content), "count": SEEDS}}
    return {**described, "kind": "none" if options.controller is None else "law"}


def describe_set(found: EvaluationSet) -> dict[str, Any]:
    """A frozen set: its hash, the common settings of its environments, and its first plants."""
    plants = [{key: value for key, value in plant.to_dict().items() if value != []} for plant in found.plants[:SEEDS]]
    given, capsule = found.env_kwargs["disturbances"], found.env_kwargs["capsule"] or NOMINAL
    common = {
        "task": found.task,
        "disturbances": asdict(given) if isinstance(given, Disturbances) else given,
        # Given also for the default capsule, since a driver may have been trained on another.
        "capsule": [getattr(capsule, name) for name in CONSTANTS],
    }
    return {"hash": found.hash, **common, "plants": plants}


def constants() -> dict[str, Any]:
    """The constants of the task and the plant, in SI units."""
    return {
        "control_dt": task.CONTROL_DT,
        "steps": task.EPISODE_STEPS,
        "horizons": {name: steps * task.CONTROL_DT for name, (_, steps) in task.TASKS.items()},
        "torque_limit": task.TORQUE_LIMIT,
        "theta_limit": task.THETA_LIMIT,
        **{name: getattr(NOMINAL, name) for name in ("m", "l", "g")},
        "nominal": {name: getattr(NOMINAL, name) for name in ("M", "mu", *CONSTANTS)},
        "ranges": {name: {"M": each.M, "mu": each.mu} for name, each in RANDOMIZATIONS.items() if each.M and each.mu},
        "limits": {name: getattr(RANGES, name) for name in ("M", "mu", *CONSTANTS)},
        "real": asdict(REAL),
        "start": {"theta": task.START_THETA, "theta_dot": 0.0, "x": 0.0, "x_dot": 0.0},
        "largest_state": dict(zip(Row._fields, task.LARGEST_STATE, strict=False)),
    }
