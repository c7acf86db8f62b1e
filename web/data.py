"""Data for the JavaScript: the compiled core, drivers, options, tables, networks, plants and
episodes.

All data are in one archive: the length of a header in four bytes, the header as JSON, and the
content, whose positions are in the header. Float64 arrays are stored column by column; for each
column, the lowest bytes of all numbers come first, then the next bytes. Neighbouring bytes are then
similar, which reduces the compressed size by a third.
"""

import base64
import json
import zlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from baselines.dynamic_programming.policy import TORQUES
from capsule_gym import Policy, parameters
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws import LAWS
from capsule_gym.control.lookup import find_controller
from capsule_gym.core import _core
from capsule_gym.envs.config import LARGEST_STACK, EnvConfig
from capsule_gym.envs.contract import (
    NO_CONTROLLER,
    controller_options,
    core_options,
    disturbance_options,
    plant_options,
)
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation import sets
from capsule_gym.parameters import (
    CONSTANTS,
    DISTURBANCES,
    NOMINAL,
    SENSORS,
    Disturbances,
    Randomization,
)
from capsule_gym.parameters.disturbances import LARGEST_DISTURBANCE
from capsule_gym.parameters.limits import LARGEST, LONGEST_STEP, SHORTEST_STEP
from capsule_gym.policies.policy import MOST_UNITS
from capsule_gym.policies.scripted import ScriptedPolicy
from capsule_gym.tasks import task
from capsule_gym.tasks.registry import TASKS, find_task
from web.episodes import FILE, OVER, RECORDED, RECORDINGS, SEEDS, drivers

Options = Mapping[str, float | None]

# The name for no law; the other names are those of laws.
DIRECT = "direct"
LAW_NAMES = (DIRECT, *sorted(LAWS))
SETS = (*sets.SET_NAMES, *sets.FURTHER_SET_NAMES, *sets.TASK_SET_NAMES)
# Largest friction of the motor, N m, for the capsule and for disturbances.
LARGEST_MOTOR_FRICTION = 0.2
# Accepted values of the plant's constants. The largest friction is also accepted at the smallest
# mass.
RANGES = Randomization(
    M=(0.2, _core.M_BOUND * NOMINAL.M), mu=(0.0, _core.MU_BOUND), m=(0.1, 0.18), l=(0.25, 0.35), g=(1.0, 15.0),
    k=(0.2, 0.6), c=(0.05, 0.15), static_ratio=(1.0, 1.5), backward_ratio=(0.5, 1.5), viscous=(0.0, 2.0),
    stribeck_speed=(0.02, 1.0), slope=(-0.2, 0.2), motor_friction=(0.0, LARGEST_MOTOR_FRICTION),
)  # fmt: skip
# The stiffest plants that the page accepts; motors have the friction of the capsule and of
# disturbances.
STIFFEST: dict[str, Any] = {
    "randomization": RANGES,
    "disturbances": Disturbances(motor_friction=LARGEST_MOTOR_FRICTION),
}


class Archive:
    """Bytes and arrays; equal contents are stored once."""

    def __init__(self) -> None:
        self.content = b""

    def add(self, content: bytes) -> dict[str, int]:
        """Stores bytes; returns their entry in the header."""
        at = self.content.find(content)
        if at < 0:
            at, self.content = len(self.content), self.content + content
        return {"at": at, "size": len(content)}

    def add_array(self, array: Any) -> dict[str, int]:
        """Stores a float64 array of one or two dimensions; returns its entry in the header."""
        table = np.ascontiguousarray(array, "<f8").reshape(len(array), -1)
        rows, columns = table.shape
        content = table.view(np.uint8).reshape(rows, columns, 8).transpose(1, 2, 0).tobytes()
        return {**self.add(content), "rows": rows, "columns": columns}


def pack_data(module: bytes) -> str:
    """The archive with all data for the JavaScript, compressed, in base64; `module` is the compiled
    core.
    """
    archive = Archive()
    ranges = parameters.RANDOMIZATIONS.items()
    header = {
        "module": archive.add(module),
        "tasks": {name: pack_options(EnvConfig(task=name)) for name in TASKS},
        "controllers": {name: describe_controller(name, archive) for name in LAW_NAMES},
        "drivers": [describe_driver(policy, archive) for policy in drivers().values()],
        "torques": TORQUES.tolist(),
        "sets": {name: describe_set(sets.load_set(name)) for name in SETS},
        "ideal": asdict(Disturbances()),
        "accepted": {
            "options": option_limits(),
            "sensors": SENSORS,
            "substeps": _core.MOST_SUBSTEPS,
            "commands": _core.COMMANDS,
            "command": _core.LARGEST_COMMAND,
            "units": MOST_UNITS,
            "padding": _core.PADDING,
        },
        "constants": {  # in SI units
            **{
                name.lower(): getattr(task, name)
                for name in ("CONTROL_DT", "TORQUE_LIMIT", "THETA_LIMIT")
            },
            "steps": task.EPISODE_STEPS,
            "horizons": {
                each.name: each.episode_steps * task.CONTROL_DT for each in TASKS.values()
            },
            **{name: getattr(NOMINAL, name) for name in ("m", "l", "g")},
            "nominal": {name: getattr(NOMINAL, name) for name in ("M", "mu", *CONSTANTS)},
            "ranges": {name: {"M": each.M, "mu": each.mu} for name, each in ranges if each.M},
            "limits": {
                name: getattr(RANGES, name) or (-LARGEST, LARGEST)
                for name in ("M", "mu", *CONSTANTS)
            },
            "real": asdict(parameters.REAL),
            "start": {"theta": task.START_THETA, "theta_dot": 0.0, "x": 0.0, "x_dot": 0.0},
            "largest_state": dict(zip(_core.ROW_NAMES, task.LARGEST_STATE, strict=False)),
        },
        "episodes": json.loads(FILE.read_text("utf-8")),
    }
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    return base64.b64encode(
        zlib.compress(len(text).to_bytes(4, "little") + text + archive.content, 9)
    ).decode()


def as_numbers(options: Options) -> dict[str, float | None]:
    """Options of the core as JSON contains them."""
    return {name: None if value is None else float(value) for name, value in options.items()}


def option_limits() -> dict[str, tuple[float, float]]:
    """The accepted values of the core's options."""
    limits: dict[str, tuple[float, float]] = dict.fromkeys(_core.OPTIONS, (-LARGEST, LARGEST))
    limits["stack_size"] = 1, LARGEST_STACK
    limits |= dict.fromkeys(("control_dt", "physics_dt"), (SHORTEST_STEP, LONGEST_STEP))
    limits |= dict.fromkeys(("stick_threshold", "x_noise"), (0.0, LARGEST_DISTURBANCE))
    own = {"motor_friction": (0.0, LARGEST_MOTOR_FRICTION)}
    for name in DISTURBANCES:
        both = f"disturbances_{name}_low", f"disturbances_{name}_high"
        limits |= dict.fromkeys(both, own.get(name) or Disturbances.limits(name))
    return limits


def pack_options(options: EnvConfig) -> dict[str, float | None]:
    """All options of the core for an environment whose resets draw neither plant nor state.

    Raises:
        ValueError: if the integrator's step is too long for a plant that the page accepts.
    """
    own = replace(options, task=find_task(options.task).name, **sets.EPISODE_SETTINGS)
    Simulation(1, replace(own, **STIFFEST))
    given = core_options(own, find_controller(options.controller))
    return as_numbers({**dict.fromkeys(_core.OPTIONS), **given})


def describe_controller(name: str, archive: Archive) -> dict[str, Any]:
    """A law, its reference table, its tasks, and the options of the core that follow from it."""
    controller = None if name == DIRECT else find_controller(f"baselines:{name}")
    acting = controller or NO_CONTROLLER
    assert isinstance(acting.law, CoreLaw)
    return {
        "law": acting.law.name,
        # They may be infinite, which JSON lacks, and a law may have none.
        "constants": archive.add_array([*acting.law.constants, 0.0]),
        "memory": acting.memory,
        "table": archive.add_array(acting.reference),
        "tasks": [find_task(acting.task).name] if acting.task else list(TASKS),
        "options": as_numbers(controller_options(controller)),
    }


def describe_policy(name: str, policy: Policy | ScriptedPolicy) -> dict[str, Any]:
    """The description of a policy for the browser; the network of a trained one is a float64 array.

    Raises:
        ValueError: if the policy's environment is not one of the browser's.
    """
    options = EnvConfig(**policy.env_kwargs)
    law = (
        DIRECT if options.controller is None else str(options.controller).removeprefix("baselines:")
    )
    if law not in LAW_NAMES:
        raise ValueError(f"controller must be None or a law of baselines, got {options.controller}")
    described: dict[str, Any] = {
        "name": name,
        "description": policy.description,
        "task": find_task(options.task).name,
    }
    described |= {"controller": law, "options": pack_options(options)}
    if isinstance(policy, Policy):
        described |= {"kind": "policy", "seed": policy.training_seed, "network": policy._network}
    return described


def describe_driver(policy: Policy | ScriptedPolicy, archive: Archive) -> dict[str, Any]:
    """The description of a driver for the page and the step."""
    name, described = policy.name, describe_policy(policy.name, policy)
    if isinstance(policy, Policy):
        return {**described, "network": archive.add_array(described["network"])}
    if name in RECORDED:
        recordings = {}
        for each in sets.SET_NAMES:
            taken = np.load(RECORDINGS)[f"{name} {each}"]
            steps = (taken != OVER).sum(axis=1).tolist()
            recordings[each] = {**archive.add(taken[taken != OVER].tobytes()), "steps": steps}
        return {**described, "kind": "recording", "recordings": recordings}
    return {**described, "kind": "law"}


def describe_set(found: sets.EvaluationSet) -> dict[str, Any]:
    """A frozen set: its hash, the options of the core that its environments share, and its first
    plants.
    """
    plants = [
        {key: value for key, value in plant.to_dict().items() if value != []}
        for plant in found.plants[:SEEDS]
    ]
    kwargs = found.env_kwargs
    # The capsule is given also where it is the default, since a driver may have been trained on
    # another.
    options = {
        **plant_options(kwargs["capsule"] or NOMINAL, Randomization()),
        **disturbance_options(Disturbances.named(kwargs["disturbances"])),
    }
    named = kwargs["disturbances"] if isinstance(kwargs["disturbances"], str) else None
    return {
        "hash": found.hash,
        "task": found.task,
        "options": as_numbers(options),
        "disturbances": named,
        "plants": plants,
    }
