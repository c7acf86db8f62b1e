"""What follows from the options of an environment is equal in JavaScript and in Python, bit for
bit."""

import json

import numpy as np

from capsule_gym import CapsuleEnv
from capsule_gym.control.laws import LAWS
from capsule_gym.control.lookup import find_controller
from capsule_gym.core import _core
from capsule_gym.envs.contract import core_options, describe
from capsule_gym.parameters import (
    CONSTANTS,
    DISTURBANCES,
    NOMINAL,
    SENSORS,
    Capsule,
    Disturbances,
    Randomization,
)
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.velocity import with_commands

COUNT, STEPS = 200, 6
# Largest values of constants that are 0 on the nominal capsule, and of disturbances.
LARGEST_CONSTANTS = {"viscous": 1.0, "stribeck_speed": 0.5, "slope": 0.1, "motor_friction": 0.1}
LARGEST_DISTURBANCES = {"latency": 0.06, "drift_time": 1.0, "lag": 0.01, "push": 3.0}


def draw_range(rng, low, high):
    """A range within these limits."""
    return tuple(np.sort(rng.uniform(low, high, 2)).tolist())


def draw_constant(rng, name):
    """A range of a constant of the plant."""
    value = getattr(NOMINAL, name)
    if name in LARGEST_CONSTANTS:
        return draw_range(rng, 0.3 * LARGEST_CONSTANTS[name], LARGEST_CONSTANTS[name])
    return draw_range(
        rng, max(1.0, 0.9 * value) if name == "static_ratio" else 0.9 * value, 1.1 * value
    )


def draw_capsule(rng):
    """Some constants of the plant, or None for the default."""
    if rng.random() < 0.5:
        return None
    names = [name for name in CONSTANTS if rng.random() < 0.3]
    return Capsule(
        M=rng.uniform(0.4, 0.7),
        mu=rng.uniform(0.0, 0.3),
        normal_force=str(rng.choice(["newton", "paper"])),
        **{name: draw_constant(rng, name)[0] for name in names},
    )


def draw_randomization(rng):
    """A named randomization, or ranges of some constants or of all."""
    if rng.random() < 0.4:
        return str(rng.choice(["none", "paper", "wide", "sticky", "real", "real-wide"]))
    share = rng.choice([0.0, 0.3, 1.0], p=[0.4, 0.55, 0.05])
    return Randomization(
        M=draw_range(rng, 0.4, 0.8) if rng.random() < 0.7 else None,
        mu=draw_range(rng, 0.01, 0.4) if rng.random() < 0.7 else None,
        log_mu=bool(rng.random() < 0.5),
        **{name: draw_constant(rng, name) for name in CONSTANTS if rng.random() < share},
    )


def draw_disturbances(rng):
    """No disturbances, the real ones, or ranges and numbers for some fields."""
    if rng.random() < 0.4:
        return str(rng.choice(["none", "real"]))
    fields = {}
    for name in DISTURBANCES:
        low, high = draw_range(rng, 1e-3, LARGEST_DISTURBANCES.get(name, 0.05))
        if rng.random() < 0.5:
            fields[name] = (low, high) if rng.random() < 0.5 else high
    return Disturbances(
        **fields,
        unmeasured=tuple(name for name in SENSORS if rng.random() < 0.2),
        controls=str(rng.choice(["both", "law", "agent"])),
        stick_threshold=rng.uniform(0.0, 0.02),
        x_noise=rng.uniform(0.0, 0.01) if rng.random() < 0.5 else None,
    )


def draw_kwargs(rng):
    """Random arguments of an environment."""
    task = str(rng.choice(list(TASKS)))
    laws = [f"baselines:{name}" for name, law in LAWS.items() if law().task in (None, task)]
    controller = None if rng.random() < 0.3 else str(rng.choice(laws))
    law_dt = find_controller(controller).dt if controller else 0.0
    period = rng.choice([0.01, 0.02, 0.04])
    kwargs = {
        "task": with_commands(*draw_range(rng, -0.2, 0.2))
        if task == "velocity" and rng.random() < 0.5
        else task,
        "controller": controller,
        "capsule": draw_capsule(rng),
        "randomization": draw_randomization(rng),
        "disturbances": draw_disturbances(rng),
        "torque_limit": rng.uniform(0.5, 2.0),
        "residual_limit": rng.uniform(0.0, 3.0) if rng.random() < 0.5 else None,
        "total_torque": bool(rng.random() < 0.3),
        "energy_weight": rng.uniform(0.0, 5.0),
        "termination_penalty": rng.uniform(0.0, 100.0),
        "observe_parameters": bool(rng.random() < 0.5),
        "observe_estimates": bool(rng.random() < 0.5),
        "stack_size": int(rng.integers(1, 5)),
        "goal_env": bool(task == "goal" and rng.random() < 0.5),
        "control_dt": float(period) if law_dt < 0.01 else 2.0 * law_dt,
        "physics_dt": float(rng.choice([5e-4, 1e-3])) if rng.random() < 0.5 else None,
    }
    if rng.random() < 0.3:
        kwargs["initial_range"] = (rng.uniform(0.0, 1.0), rng.uniform(0.0, 5.0))
    else:
        kwargs["initial_noise"] = rng.uniform(0.0, 0.2) if rng.random() < 0.5 else 0.0
    # The default capsule is that of the task.
    return {name: value for name, value in kwargs.items() if (name, value) != ("capsule", None)}


def draw_environment(rng):
    """An environment with random arguments; those that do not fit each other are drawn again."""
    while True:
        try:
            return CapsuleEnv(**draw_kwargs(rng))
        except ValueError as error:
            if "physics_dt" not in str(error) and "Painleve" not in str(error):
                raise


def hexadecimal(numbers):
    """The bits of float64 numbers."""
    return np.array(numbers, np.float64).tobytes().hex()


def compute(env, seed, action):
    """What Python says of an environment and of a short episode."""
    simulation = env.simulation
    description = describe(simulation.options, simulation.controller)
    names, low, high = zip(*description.entries, strict=True)
    env.reset(seed=seed)
    for _ in range(STEPS):
        *_, terminated, _, _ = env.step(np.array([action], np.float32))
        if terminated:
            break
    metrics = env.episode_metrics(description.layout.steps)
    return {
        "settings": [list(_core.Settings.__match_args__), hexadecimal(description.settings)],
        "layout": dict(zip(_core.Layout.__match_args__, description.layout, strict=True)),
        "entries": [list(names), hexadecimal(low), hexadecimal(high)],
        "draws": hexadecimal(description.draws),
        "metrics": [list(metrics), hexadecimal(list(metrics.values()))],
        "world": hexadecimal(simulation.world),
    }


SCRIPT = """
import { readFileSync } from "node:fs";
const hexadecimal = (numbers) => bytes(Float64Array.from(numbers.flat()));
const found = [];
for (const { controller, task, options, seed, action } of JSON.parse(readFileSync(process.argv[1]))) {
  const capsule = await live.load(controller, { task, options });
  const { settings, layout, entries, draws } = capsule.description;
  capsule.reset(capsule.draws ? { seed } : {});
  for (let n = 0; n < STEPS && capsule.info.termination === "none"; n++) capsule.step(action);
  const { metrics } = capsule;
  found.push({
    settings: [Object.keys(settings), hexadecimal(Object.values(settings))],
    layout,
    entries: [entries.map(([name]) => name), ...[1, 2].map((n) => hexadecimal(entries.map((entry) => entry[n])))],
    draws: hexadecimal(draws),
    metrics: [Object.keys(metrics), hexadecimal(Object.values(metrics))],
    world: bytes(capsule.world),
  });
}
show(found);
"""


def test_javascript_asks_the_core_as_python_does(node, tmp_path):
    rng = np.random.default_rng(11)
    cases, expected, seen = [], [], set()
    for seed in range(COUNT):
        env = draw_environment(rng)
        action = float(np.float32(rng.uniform(-0.3, 0.3)))
        expected.append(compute(env, seed, action))
        options, controller = env.simulation.options, env.simulation.controller
        law = str(options.controller or "direct").removeprefix("baselines:")
        task = find_task(options.task).name
        given = core_options(options, controller)
        numbers = {name: None if value is None else float(value) for name, value in given.items()}
        cases.append(
            {"controller": law, "task": task, "options": numbers, "seed": seed, "action": action}
        )
        seen |= {law, task, *(name for name, value in numbers.items() if value)}
    # Everything is drawn at least once.
    assert seen >= {"direct", *LAWS, *TASKS, *_core.OPTIONS} - {"task"}
    file = tmp_path / "cases.json"
    file.write_text(json.dumps(cases), encoding="utf-8")
    found = node(SCRIPT.replace("STEPS", str(STEPS)), str(file))
    for case, mine, theirs in zip(cases, expected, found, strict=True):
        for name, value in mine.items():
            assert theirs[name] == value, (name, case)
