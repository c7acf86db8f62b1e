"""What follows from the options of an environment has the same bits in JavaScript and Python."""

import json

import numpy as np
import pytest

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
from web.data import describe_tasks

COUNT = 200
STEPS = 6
# Largest values of constants that are 0 on the nominal capsule, and of disturbances.
LARGEST_CONSTANTS = {"viscous": 1.0, "stribeck_speed": 0.5, "slope": 0.1, "motor_friction": 0.1}
LARGEST_DISTURBANCES = {
    "latency": 0.06,
    "drift_time": 1.0,
    "lag": 0.01,
    "push": 3.0,
    "lost": 0.7,
    "hold": 4.0,
}
# Arguments of the environment: numbers with their limits, and flags.
NUMBERS = {
    "torque_limit": (0.5, 2.0),
    "residual_limit": (0.0, 3.0),
    "energy_weight": (0.0, 5.0),
    "termination_penalty": (0.0, 100.0),
}
FLAGS = ("total_torque", "observe_parameters", "observe_estimates")


def chance(rng, probability=0.5):
    return bool(rng.random() < probability)


def pick(rng, *names):
    return str(rng.choice(names))


def draw_range(rng, low, high):
    """A range within these limits."""
    return tuple(np.sort(rng.uniform(low, high, 2)).tolist())


def draw_constant(rng, name):
    """A range of a constant of the plant."""
    if name in LARGEST_CONSTANTS:
        largest = LARGEST_CONSTANTS[name]
        return draw_range(rng, 0.3 * largest, largest)
    value = getattr(NOMINAL, name)
    lowest = 0.9 * value
    if name == "static_ratio":
        lowest = max(1.0, lowest)
    return draw_range(rng, lowest, 1.1 * value)


def draw_capsule(rng):
    """A capsule of which some constants differ from the nominal one."""
    constants = {name: draw_constant(rng, name)[0] for name in CONSTANTS if chance(rng, 0.3)}
    normal_force = pick(rng, "newton", "paper")
    M = rng.uniform(0.4, 0.7)
    mu = rng.uniform(0.0, 0.3)
    return Capsule(M=M, mu=mu, normal_force=normal_force, **constants)


def draw_randomization(rng):
    """A named randomization, or ranges of some constants or of all."""
    if chance(rng, 0.4):
        return pick(rng, "none", "paper", "wide", "sticky", "real", "real-wide")
    share = rng.choice([0.0, 0.3, 1.0], p=[0.4, 0.55, 0.05])
    ranges = {name: draw_constant(rng, name) for name in CONSTANTS if chance(rng, share)}
    if chance(rng, 0.7):
        ranges["M"] = draw_range(rng, 0.4, 0.8)
    if chance(rng, 0.7):
        ranges["mu"] = draw_range(rng, 0.01, 0.4)
    return Randomization(log_mu=chance(rng), **ranges)


def draw_disturbances(rng):
    """No disturbances, the real ones, or ranges and numbers for some fields."""
    if chance(rng, 0.4):
        return pick(rng, "none", "real")
    fields = {}
    for name in DISTURBANCES:
        low, high = draw_range(rng, 1e-3, LARGEST_DISTURBANCES.get(name, 0.05))
        if chance(rng):
            fields[name] = (low, high) if chance(rng) else high
    if chance(rng):
        fields["x_noise"] = rng.uniform(0.0, 0.01)
    fields["unmeasured"] = tuple(name for name in SENSORS if chance(rng, 0.2))
    fields["controls"] = pick(rng, "both", "law", "agent")
    return Disturbances(stick_threshold=rng.uniform(0.0, 0.02), **fields)


def draw_controller(rng, task):
    """No law, or one that fits the task."""
    if chance(rng, 0.3):
        return None
    laws = [name for name, law in LAWS.items() if law().task in (None, task)]
    return "baselines:" + pick(rng, *laws)


def draw_control_dt(rng, controller):
    """A length of a step that is a multiple of the law's."""
    law_dt = find_controller(controller).dt if controller else 0.0
    if law_dt >= 0.01:
        return 2.0 * law_dt
    return float(rng.choice([0.01, 0.02, 0.04]))


def draw_kwargs(rng):
    """Random arguments of an environment; some are left out."""
    task = pick(rng, *TASKS)
    controller = draw_controller(rng, task)
    kwargs = {"task": task, "controller": controller}
    if task == "velocity" and chance(rng):
        kwargs["task"] = with_commands(*draw_range(rng, -0.2, 0.2))
    if task == "goal":
        kwargs["goal_env"] = chance(rng)
    # The default capsule is that of the task.
    if chance(rng):
        kwargs["capsule"] = draw_capsule(rng)
    kwargs["randomization"] = draw_randomization(rng)
    kwargs["disturbances"] = draw_disturbances(rng)
    for name, limits in NUMBERS.items():
        if chance(rng, 0.8):
            kwargs[name] = rng.uniform(*limits)
    for name in FLAGS:
        kwargs[name] = chance(rng)
    kwargs["stack_size"] = int(rng.integers(1, 5))
    kwargs["control_dt"] = draw_control_dt(rng, controller)
    if chance(rng):
        kwargs["physics_dt"] = float(rng.choice([5e-4, 1e-3]))
    start = rng.choice([None, "initial_noise", "initial_range"])
    if start == "initial_noise":
        kwargs[start] = rng.uniform(0.0, 0.2)
    elif start == "initial_range":
        kwargs[start] = (rng.uniform(0.0, 1.0), rng.uniform(0.0, 5.0))
    return kwargs


# Parts of the errors of arguments that do not fit each other.
UNFIT = ("physics_dt", "Painleve", "total_torque", "controls", "left out", "log_mu")


def draw_environment(rng):
    """An environment with random arguments; those that do not fit each other are drawn again."""
    while True:
        try:
            return CapsuleEnv(**draw_kwargs(rng))
        except ValueError as error:
            if not any(part in str(error) for part in UNFIT):
                raise


def describe_case(env, seed, action):
    """What JavaScript needs for the same environment and episode."""
    options = env.simulation.options
    law = str(options.controller or "direct")
    numbers = core_options(options, env.simulation.controller)
    for name, value in numbers.items():
        if value is not None:
            numbers[name] = float(value)
    return {
        "controller": law.removeprefix("baselines:"),
        "task": find_task(options.task).name,
        "options": numbers,
        "seed": seed,
        "action": action,
    }


@pytest.fixture(scope="module")
def drawn():
    """Environments, and what JavaScript needs for the same ones."""
    rng = np.random.default_rng(11)
    environments = [draw_environment(rng) for _ in range(COUNT)]
    cases = []
    for seed, env in enumerate(environments):
        action = np.float32(rng.uniform(-0.3, 0.3))
        cases.append(describe_case(env, seed, float(action)))
    return environments, cases


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
    layout = zip(_core.Layout.__match_args__, description.layout, strict=True)
    settings = list(_core.Settings.__match_args__)
    return {
        "settings": [settings, hexadecimal(description.settings)],
        "layout": dict(layout),
        "entries": [list(names), hexadecimal(low), hexadecimal(high)],
        "draws": hexadecimal(description.draws),
        "metrics": [list(metrics), hexadecimal(list(metrics.values()))],
        "world": hexadecimal(simulation.world),
    }


SCRIPT = """
import { readFileSync } from "node:fs";
const hexadecimal = (numbers) => bytes(Float64Array.from(numbers.flat()));
const cases = JSON.parse(readFileSync(process.argv[1]));
const found = [];
for (const { controller, task, options, seed, action } of cases) {
  const capsule = await live.load(controller, { task, options });
  const { settings, layout, entries, draws } = capsule.description;
  capsule.reset(capsule.draws ? { seed } : {});
  for (let n = 0; n < STEPS && capsule.info.termination === "none"; n++) capsule.step(action);
  const { metrics } = capsule;
  const column = (n) => entries.map((entry) => entry[n]);
  found.push({
    settings: [Object.keys(settings), hexadecimal(Object.values(settings))],
    layout,
    entries: [column(0), hexadecimal(column(1)), hexadecimal(column(2))],
    draws: hexadecimal(draws),
    metrics: [Object.keys(metrics), hexadecimal(Object.values(metrics))],
    world: bytes(capsule.world),
  });
}
show(found);
""".replace("STEPS", str(STEPS))


def test_everything_is_drawn_at_least_once(drawn):
    _, cases = drawn
    seen = set()
    for case in cases:
        seen |= {case["controller"], case["task"]}
        seen.update(name for name, value in case["options"].items() if value)
    assert seen >= {"direct", *LAWS, *TASKS}
    assert seen >= set(_core.OPTIONS) - {"task"}


def test_javascript_asks_the_core_as_python_does(node, tmp_path, drawn):
    environments, cases = drawn
    file = tmp_path / "cases.json"
    file.write_text(json.dumps(cases), "utf-8")
    found = node(SCRIPT, file)
    for env, case, theirs in zip(environments, cases, found, strict=True):
        for name, value in compute(env, case["seed"], case["action"]).items():
            assert theirs[name] == value, (name, case)


def test_an_episode_of_the_page_starts_as_one_of_the_environment():
    _, info = CapsuleEnv().reset(seed=0)
    assert list(describe_tasks()["start"].values()) == info["state"].tolist()
