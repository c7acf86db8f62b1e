"""Data for the JavaScript: the compiled core, drivers, settings, tables, networks, plants and episodes.

All data are in one archive: the length of a header in four bytes, the header as JSON, and the content, whose positions
are in the header. Float64 arrays are stored column by column; for each column, the lowest bytes of all numbers come
first, then the next bytes. Neighbouring bytes are then similar, which reduces the compressed size by a third.
"""

import base64
import json
import zlib
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from baselines.dynamic_programming.policy import TORQUES
from capsule_gym import Policy, parameters
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws import LAWS
from capsule_gym.control.lookup import find_controller
from capsule_gym.core import _core
from capsule_gym.core.layout import Row
from capsule_gym.envs import resets
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.observation import M_BOUND, MU_BOUND
from capsule_gym.envs.settings import NO_CONTROLLER
from capsule_gym.envs.simulation import LARGEST_KEY, Simulation
from capsule_gym.evaluation import sets
from capsule_gym.parameters import CONSTANTS, DISTURBANCES, NOMINAL, Capsule, Disturbances, Randomization
from capsule_gym.policies.scripted import ScriptedPolicy
from capsule_gym.tasks import task
from capsule_gym.tasks.registry import TASKS, find_task
from web.episodes import FILE, OVER, RECORDED, RECORDINGS, SEEDS, drivers

# The name for no law; the other names are those of laws.
DIRECT = "direct"
LAW_NAMES = (DIRECT, *sorted(LAWS))
SETS = (*sets.SET_NAMES, *sets.FURTHER_SET_NAMES, *sets.TASK_SET_NAMES)
# Largest friction of the motor, N m, for the capsule and for disturbances.
LARGEST_MOTOR_FRICTION = 0.2
# Accepted values of the plant's constants. The largest friction is also accepted at the smallest mass.
RANGES = Randomization(
    M=(0.2, M_BOUND * NOMINAL.M), mu=(0.0, MU_BOUND), m=(0.1, 0.18), l=(0.25, 0.35), g=(1.0, 15.0), k=(0.2, 0.6),
    c=(0.05, 0.15), static_ratio=(1.0, 1.5), backward_ratio=(0.5, 1.5), viscous=(0.0, 2.0), stribeck_speed=(0.02, 1.0),
    slope=(-0.2, 0.2), motor_friction=(0.0, LARGEST_MOTOR_FRICTION),
)  # fmt: skip


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
    """The archive with all data for the JavaScript, compressed, in base64; `module` is the compiled core."""
    archive = Archive()
    # The names and sizes of what the core takes.
    names = "ROW_NAMES", "SETTINGS", "BATCH", "ESTIMATOR_CELLS", "HISTORY_ROWS", "PADDING"
    core = {name.lower(): getattr(_core, name) for name in names}
    # The fields of a task's memory, those shown in `info`, and the draws at a reset, whose rows follow the rest.
    tasks = {}
    for own in map(find_task, _core.TASKS):
        table = resets.draw_table(own.rows - len(own.draws), resets.Stream.task, own.draws).tolist()
        tasks[own.name] = {"memory": own.fields, "shown": own.shown, "options": list(own.options), "table": table}
    # What a varied plant draws.
    draws = [task.Draw(0.0, 0.0)] * (len(CONSTANTS) + len(DISTURBANCES)) + [task.Draw(0.0, LARGEST_KEY)]
    ranges, motor = parameters.RANDOMIZATIONS.items(), {"motor_friction": (0.0, LARGEST_MOTOR_FRICTION)}
    header = {
        "module": archive.add(module),
        "core": {**core, "terminations": [termination.name for termination in task.Termination]},
        "tasks": tasks,
        "variation": {
            **{"constants": CONSTANTS, "disturbances": DISTURBANCES},
            "table": resets.draw_table(Row.drawn_m, resets.Stream.variation, draws).tolist(),
            "limits": {**dict(zip(DISTURBANCES, map(Disturbances.limits, DISTURBANCES), strict=True)), **motor},
            "ideal": asdict(Disturbances()),
        },
        "controllers": {name: describe_controller(name, archive) for name in LAW_NAMES},
        "drivers": [describe_driver(policy, archive) for policy in drivers().values()],
        "torques": TORQUES.tolist(),
        "sets": {name: describe_set(sets.load_set(name)) for name in SETS},
        "constants": {  # in SI units
            **{name.lower(): getattr(task, name) for name in ("CONTROL_DT", "TORQUE_LIMIT", "THETA_LIMIT")},
            "steps": task.EPISODE_STEPS,
            "horizons": {each.name: each.episode_steps * task.CONTROL_DT for each in TASKS.values()},
            **{name: getattr(NOMINAL, name) for name in ("m", "l", "g")},
            "nominal": {name: getattr(NOMINAL, name) for name in ("M", "mu", *CONSTANTS)},
            "ranges": {name: {"M": each.M, "mu": each.mu} for name, each in ranges if each.M},
            "limits": {name: getattr(RANGES, name) for name in ("M", "mu", *CONSTANTS)},
            "real": asdict(parameters.REAL),
            "start": {"theta": task.START_THETA, "theta_dot": 0.0, "x": 0.0, "x_dot": 0.0},
            "largest_state": dict(zip(_core.ROW_NAMES, task.LARGEST_STATE, strict=False)),
        },
        "episodes": json.loads(FILE.read_text("utf-8")),
    }
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    return base64.b64encode(zlib.compress(len(text).to_bytes(4, "little") + text + archive.content, 9)).decode()


def describe_controller(name: str, archive: Archive) -> dict[str, Any]:
    """A law, its reference table, and the settings of the step for each of its tasks."""
    controller = None if name == DIRECT else f"baselines:{name}"
    acting = find_controller(controller) or NO_CONTROLLER
    tasks = [find_task(acting.task).name] if acting.task else list(TASKS)
    assert isinstance(acting.law, CoreLaw)
    return {
        "law": acting.law.number,
        # They may be infinite, which JSON lacks, and a law may have none.
        "constants": archive.add_array([*acting.law.constants, 0.0]),
        "memory": acting.memory,
        "table": archive.add_array(acting.reference),
        "settings": {each: describe_settings(EnvConfig(controller=controller, task=each)) for each in tasks},
    }


def describe_settings(options: EnvConfig) -> dict[str, Any]:
    """The settings of the step for an environment, ideal and disturbed, and the length of its episodes."""
    # The stiffest plants that the page accepts; motors have the friction of the capsule and of disturbances.
    stiffest = Disturbances(motor_friction=LARGEST_MOTOR_FRICTION)
    capsule = Simulation(1, replace(options, randomization=RANGES, disturbances=stiffest)).capsule
    if capsule.plant().extended:
        raise ValueError(f"options must be of a level floor with Coulomb's friction and Newton's force, got {options}")
    ideal, disturbed = (
        Simulation(1, replace(options, randomization="none", disturbances=given)) for given in ("none", Disturbances())
    )
    return {
        "ideal": ideal.fields["settings"].tolist(),
        "disturbed": disturbed.fields["settings"].tolist(),
        **_common(capsule, options.disturbances),
        "entries": ideal.observations.shape[1],
        "control_dt": options.control_dt,
        "steps": round(ideal.task.episode_steps * task.CONTROL_DT / options.control_dt),
    }


def _common(capsule: Capsule, disturbances: str | Disturbances) -> dict[str, Any]:
    """What all plants of an environment share."""
    given = asdict(disturbances) if isinstance(disturbances, Disturbances) else disturbances
    return {"capsule": [getattr(capsule, name) for name in CONSTANTS], "disturbances": given}


def describe_policy(name: str, policy: Policy | ScriptedPolicy) -> dict[str, Any]:
    """The description of a policy for the browser; the network of a trained one is a float64 array.

    Raises:
        ValueError: if the policy's environment is not one of the browser's.
    """
    options = EnvConfig(**policy.env_kwargs)
    law = DIRECT if options.controller is None else str(options.controller).removeprefix("baselines:")
    if law not in LAW_NAMES:
        raise ValueError(f"controller must be None or a law of baselines, got {options.controller}")
    described: dict[str, Any] = {"name": name, "description": policy.description, "task": find_task(options.task).name}
    described |= {"controller": law, "settings": describe_settings(options)}
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
    """A frozen set: its hash, the common settings of its environments, and its first plants."""
    plants = [{key: value for key, value in plant.to_dict().items() if value != []} for plant in found.plants[:SEEDS]]
    # The capsule is given also where it is the default, since a driver may have been trained on another.
    common = _common(found.env_kwargs["capsule"] or NOMINAL, found.env_kwargs["disturbances"])
    return {"hash": found.hash, "task": found.task, **common, "plants": plants}
