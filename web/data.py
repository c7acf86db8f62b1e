"""Data for the JavaScript: the compiled core, drivers, options, tables, networks and episodes.

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
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from agents.leaderboard.page import GROUPS, OTHER_LAWS
from baselines import lqr, mpc
from baselines.dynamic_programming import grid
from baselines.dynamic_programming.archive import known_results
from baselines.dynamic_programming.policy import FAILURE_SCORE, TORQUES
from baselines.dynamic_programming.problem import NOMINAL_MARGIN, Problem
from baselines.dynamic_programming.solver import cell_curvature
from capsule_gym import Policy, parameters
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws import LAWS
from capsule_gym.control.lookup import find_controller
from capsule_gym.core import _core
from capsule_gym.core.layout import STATE
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
from capsule_gym.evaluation.candidates import find_candidate
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
from web.episodes import OVER, RECORDED, RECORDINGS, SEEDS, committed_episodes, drivers

Options = Mapping[str, float | None]

DESCRIPTIONS = Path(__file__).with_name("descriptions.json")
# The name for no law; the other names are those of laws.
DIRECT = "direct"
LAW_NAMES = (DIRECT, *sorted(LAWS))
SETS = (*sets.SET_NAMES, *sets.FURTHER_SET_NAMES, *sets.TASK_SET_NAMES)
# All constants of a plant.
PLANT = ("M", "mu", *CONSTANTS)
# Largest friction of the motor, N m, for the capsule and for disturbances.
LARGEST_MOTOR_FRICTION = 0.2
# Accepted values of the plant's constants. The largest friction is also accepted at the smallest
# mass.
RANGES = Randomization(
    M=(0.2, _core.M_BOUND * NOMINAL.M),
    mu=(0.0, _core.MU_BOUND),
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


class Archive:
    """Bytes and arrays; equal contents are stored once."""

    def __init__(self) -> None:
        self.content = b""

    def add(self, content: bytes) -> dict[str, int]:
        """Stores bytes; returns their entry in the header."""
        at = self.content.find(content)
        if at < 0:
            at = len(self.content)
            self.content += content
        return {"at": at, "size": len(content)}

    def add_array(self, array: Any) -> dict[str, int]:
        """Stores a float64 array of one or two dimensions; returns its entry in the header."""
        numbers = np.ascontiguousarray(array, "<f8")
        table = numbers.reshape(len(numbers), -1)
        rows, columns = table.shape
        significance = table.view(np.uint8).reshape(rows, columns, 8)
        entry = self.add(significance.transpose(1, 2, 0).tobytes())
        return {**entry, "rows": rows, "columns": columns}


def pack_data(module: bytes) -> str:
    """The archive with all data for the JavaScript, compressed, in base64.

    Args:
        module: the compiled core.
    """
    archive = Archive()
    header: dict[str, Any] = {"module": archive.add(module)}
    header["tasks"] = {name: pack_options(EnvConfig(task=name)) for name in TASKS}
    header["controllers"] = {name: describe_controller(name, archive) for name in LAW_NAMES}
    described = [describe_driver(policy, archive) for policy in drivers().values()]
    # In the order of the leaderboard's groups.
    header["drivers"] = sorted(described, key=lambda driver: [*GROUPS].index(driver["group"]))
    header["torques"] = TORQUES.tolist()
    header["sets"] = {name: describe_set(name) for name in SETS}
    header["ideal"] = asdict(Disturbances())
    header["accepted"] = accepted_values()
    header["constants"] = describe_tasks() | describe_plant()
    header["episodes"] = committed_episodes()
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    size = len(text).to_bytes(4, "little")
    packed = zlib.compress(size + text + archive.content, 9)
    return base64.b64encode(packed).decode()


def accepted_values() -> dict[str, Any]:
    """What the JavaScript accepts in options, disturbances, commands and networks."""
    return {
        "options": option_limits(),
        "sensors": SENSORS,
        "substeps": _core.MOST_SUBSTEPS,
        "commands": _core.COMMANDS,
        "command": _core.LARGEST_COMMAND,
        "units": MOST_UNITS,
        "padding": _core.PADDING,
        "header": _core.HEADER_SIZE,
        "gates": (_core.GRU, _core.LSTM),
    }


def option_limits() -> dict[str, tuple[float, float]]:
    """The accepted values of the core's options."""
    limits = dict.fromkeys(_core.OPTIONS, (-LARGEST, LARGEST))
    limits["stack_size"] = 1, LARGEST_STACK
    for name in ("control_dt", "physics_dt"):
        limits[name] = SHORTEST_STEP, LONGEST_STEP
    for name in ("stick_threshold", "x_noise"):
        limits[name] = 0.0, LARGEST_DISTURBANCE
    for name in DISTURBANCES:
        accepted = Disturbances.limits(name)
        if name == "motor_friction":
            accepted = 0.0, LARGEST_MOTOR_FRICTION
        limits[f"disturbances_{name}_low"] = accepted
        limits[f"disturbances_{name}_high"] = accepted
    return limits


def describe_tasks() -> dict[str, Any]:
    """Numbers of the tasks, in SI units."""
    start = dict.fromkeys(STATE, 0.0)
    start["theta"] = task.START_THETA
    steps = {name: each.episode_steps for name, each in TASKS.items()}
    return {
        "control_dt": task.CONTROL_DT,
        "steps": task.EPISODE_STEPS,
        "horizons": {name: count * task.CONTROL_DT for name, count in steps.items()},
        "torque_limit": task.TORQUE_LIMIT,
        "theta_limit": task.THETA_LIMIT,
        "start": start,
        "largest_state": dict(zip(STATE, task.LARGEST_STATE, strict=True)),
    }


def describe_plant() -> dict[str, Any]:
    """The constants of the plant and their ranges, in SI units."""
    nominal = {name: getattr(NOMINAL, name) for name in PLANT}
    numbers: dict[str, Any] = {name: nominal[name] for name in ("m", "l", "g")}
    numbers["nominal"] = nominal
    numbers["ranges"] = {}
    for name, each in parameters.RANDOMIZATIONS.items():
        if each.M:
            numbers["ranges"][name] = {"M": each.M, "mu": each.mu}
    numbers["limits"] = {name: getattr(RANGES, name) or (-LARGEST, LARGEST) for name in PLANT}
    numbers["real"] = asdict(parameters.REAL)
    return numbers


def as_numbers(options: Options) -> dict[str, float | None]:
    """Options of the core as JSON contains them."""
    return {name: None if value is None else float(value) for name, value in options.items()}


def pack_options(options: EnvConfig) -> dict[str, float | None]:
    """All options of the core for an environment whose resets draw neither plant nor state.

    Raises:
        ValueError: if the integrator's step is too long for a plant that the page accepts.
    """
    name = find_task(options.task).name
    frozen = replace(options, task=name, **sets.EPISODE_SETTINGS)
    # Motors have the friction of the capsule and of disturbances.
    friction = Disturbances(motor_friction=LARGEST_MOTOR_FRICTION)
    Simulation(1, replace(frozen, randomization=RANGES, disturbances=friction))
    given = core_options(frozen, find_controller(options.controller))
    return as_numbers(dict.fromkeys(_core.OPTIONS) | given)


def describe_controller(name: str, archive: Archive) -> dict[str, Any]:
    """A law, its reference table, its tasks, and the options of the core that follow from it."""
    controller = None if name == DIRECT else find_controller(f"baselines:{name}")
    acting = controller or NO_CONTROLLER
    assert isinstance(acting.law, CoreLaw)
    tasks = [find_task(acting.task).name] if acting.task else list(TASKS)
    described: dict[str, Any] = {"law": acting.law.name, "memory": acting.memory, "tasks": tasks}
    # They may be infinite, which JSON lacks, and a law may have none.
    described["constants"] = archive.add_array([*acting.law.constants, 0.0])
    described["table"] = archive.add_array(acting.reference)
    described["options"] = as_numbers(controller_options(controller))
    return described


def describe_policy(name: str, policy: Policy | ScriptedPolicy) -> dict[str, Any]:
    """The description of a policy for the browser; the network of a trained one is a float64 array.

    Raises:
        ValueError: if the policy's environment is not one of the browser's.
    """
    options = EnvConfig(**policy.env_kwargs)
    law = str(options.controller or DIRECT).removeprefix("baselines:")
    if law not in LAW_NAMES:
        raise ValueError(f"controller must be None or a law of baselines, got {options.controller}")
    described: dict[str, Any] = {"name": name, "description": policy.description}
    described["task"] = find_task(options.task).name
    described["controller"] = law
    described["options"] = pack_options(options)
    if isinstance(policy, Policy):
        described["kind"] = "policy"
        described["seed"] = policy.training_seed
        described["network"] = policy._network
    return described


def describe_driver(policy: Policy | ScriptedPolicy, archive: Archive) -> dict[str, Any]:
    """The description of a driver for the page and the step."""
    described = describe_policy(policy.name, policy)
    described["group"] = group_of(policy)
    described["description"] = plain_descriptions().get(policy.name, policy.description)
    described["senses"], described["told"] = find_candidate(policy.name).inputs
    if isinstance(policy, Policy):
        described["network"] = archive.add_array(described["network"])
    elif policy.name in RECORDED:
        described["kind"] = "recording"
        described["recordings"] = add_recordings(policy.name, archive)
    elif policy.name == "lqr":
        described["kind"] = "scripted"
        described["regulator"] = describe_regulator(archive)
    elif policy.name in ("dp-nominal", "mpc"):
        described["kind"] = "scripted"
        described["lookahead"] = describe_lookahead(archive)
        if policy.name == "mpc":
            described["planner"] = describe_planner()
    else:
        described["kind"] = "law"
    return described


def group_of(policy: Policy | ScriptedPolicy) -> str:
    """A policy's group on the leaderboard, also for one of another table."""
    for title, names in GROUPS.items():
        if policy.name in names:
            return title
    if policy.name in OTHER_LAWS:
        return "The paper"
    return "Learned" if isinstance(policy, Policy) else "Simple feedback"


@cache
def plain_descriptions() -> dict[str, str]:
    """What the policies do, by name, for readers who do not know the field."""
    return json.loads(DESCRIPTIONS.read_text("utf-8"))


def describe_regulator(archive: Archive) -> dict[str, Any]:
    """The regulator of `lqr`: a row of the table for each phase."""
    content = json.loads(lqr.FILE.read_text("utf-8"))
    return {
        "table": archive.add_array(lqr.interpolate(content).T),
        "scales": lqr.SCALES.tolist(),
        "subphases": lqr.SUBPHASES,
        "window": lqr.WINDOW,
    }


def describe_lookahead(archive: Archive) -> dict[str, Any]:
    """The nominal plant and the values of its states, for steps of `dp-nominal` and `mpc`."""
    problem = Problem(margin=NOMINAL_MARGIN)
    solution = known_results().solution(problem)
    numbers = {
        "q": problem.q,
        "margin": problem.margin,
        "failure": FAILURE_SCORE,
        "edge": grid.EDGE,
        "stretch": grid.STRETCH,
        "least_cosine": grid.MIN_COSINE,
    }
    return {
        "options": as_numbers(core_options(problem.options, None)),
        "values": archive.add_array(solution.values.ravel()),
        "axes": solution.grid.axes.tolist(),
        "nodes": solution.grid.shape,
        "curvature": float(cell_curvature(solution.curvature, solution.grid)),
        "numbers": numbers,
    }


def describe_planner() -> dict[str, Any]:
    """The settings of `mpc`; JSON has no integers of 128 bits."""
    generator: Any = np.random.default_rng(mpc.SEED).bit_generator.state["state"]
    return {
        "amplitudes": mpc.AMPLITUDES.ravel().tolist(),
        "intervals": mpc.INTERVALS,
        "state": str(generator["state"]),
        "increment": str(generator["inc"]),
    }


def add_recordings(name: str, archive: Archive) -> dict[str, Any]:
    """The recorded actions of a policy on the plants of each set."""
    recordings = {}
    for set_name in sets.SET_NAMES:
        actions = np.load(RECORDINGS)[f"{name} {set_name}"]
        taken = actions != OVER
        entry = archive.add(actions[taken].tobytes())
        recordings[set_name] = {**entry, "steps": taken.sum(axis=1).tolist()}
    return recordings


def describe_set(name: str) -> dict[str, Any]:
    """A frozen set: its hash, the core's options of its environments, and its first plants."""
    found = sets.load_set(name)
    disturbances = found.env_kwargs["disturbances"]
    # The capsule is given also where it is the default, since a driver may have been trained on
    # another.
    capsule = found.env_kwargs["capsule"] or NOMINAL
    options = plant_options(capsule, Randomization())
    options |= disturbance_options(Disturbances.named(disturbances))
    described: dict[str, Any] = {"hash": found.hash, "task": found.task}
    described["options"] = as_numbers(options)
    # The page shows the name of disturbances that have one.
    described["disturbances"] = disturbances if isinstance(disturbances, str) else None
    described["plants"] = [describe_frozen(plant) for plant in found.plants[:SEEDS]]
    return described


def describe_frozen(plant: sets.PlantSpec) -> dict[str, Any]:
    """A plant of a frozen set, without jumps if it has none."""
    return {key: value for key, value in plant.to_dict().items() if value != []}
