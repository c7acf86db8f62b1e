"""Environment steps per second, and their ratios, which must not fall: `python -m
benchmarks.throughput`.

All actions are drawn beforehand. A single environment runs whole episodes, including resets. A
batch of this package does not truncate episodes, so that all batch sizes are comparable; an
environment that fails is reset within the step.

Contenders take turns, and the 10th percentiles of their processor times are used, so that other
processes have little effect. Unlike rates, ratios are comparable between machines. A ratio below
its floor usually means that the compiler vectorises a loop no longer.
"""

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from baselines.drawing import BLUE, MUTED, new_figure, save, style
from benchmarks import mujoco
from benchmarks.measurement import machine, rates, report
from capsule_gym import ENV_ID
from capsule_gym.command_line import PositiveCount, check_output, command
from capsule_gym.core import native
from capsule_gym.core.layout import LANES, Row
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, LAW_PHYSICS_DT, EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import Capsule
from capsule_gym.tasks import task

COMMAND = "python -m benchmarks.throughput"
TURN_SECONDS = 0.02
# With random torques up to the limit, resets would dominate. The paper's torques rarely exceed this
# fraction.
ACTION_SCALE = 0.2
LAW: dict[str, Any] = {
    "controller": "baselines:adaptive",
    "residual_limit": ACTION_SCALE * task.TORQUE_LIMIT,
}
# Number of distinct actions, which are repeated; of episodes from the same states; of environments
# in most batches.
DRAWS, EPISODE, BATCH = 256, 40, 1024

# Makes one step of all environments, or a reset of one.
Step = Callable[[], object]
# The command of the C compiler, and the settings of plain C.
COMPILER = os.environ.get("CC") or shutil.which("cc")
C_SETTINGS = "m l g k c static_ratio backward_ratio torque_limit physics_dt energy_weight termination_penalty stick_threshold"
# The smallest ratio of two contenders' rates.
FLOORS = {
    ("capsule", "CartPole-v1"): 1.3,
    ("capsule, reset", "CartPole-v1, reset"): 0.25,
    ("capsule, 1024", "CartPole-v1, 1024"): 0.2,
    ("capsule, law, 1024", "capsule, 1 ms, 1024"): 0.46,
    ("capsule, core, 1024", "capsule, plain C, 1024"): 0.65,
}


def environment(env_id: str, num_envs: int = 0, *, reset: bool = False, **kwargs: Any) -> Step:
    """Steps or resets of one environment with gymnasium's default wrappers, or steps of a native
    batch.
    """
    batch: dict[str, Any] = {"num_envs": num_envs, "vectorization_mode": "vector_entry_point"}
    env: Any = gym.make_vec(env_id, **batch, **kwargs) if num_envs else gym.make(env_id, **kwargs)
    env.reset(seed=0)
    env.action_space.seed(0)
    samples = [env.action_space.sample() for _ in range(16 if num_envs else DRAWS)]
    discrete = np.asarray(samples[0]).dtype.kind == "i"
    actions = cycle(
        samples if discrete else [np.float32(ACTION_SCALE) * sample for sample in samples]
    )

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return env.reset if reset else (lambda: env.step(next(actions))) if num_envs else step


def mujoco_physics() -> Step:
    """The physics of one capsule in MuJoCo under random torques, which restarts where its ball
    meets the platform.
    """
    (model, data), limit = (
        mujoco.build("frictionloss", DIRECT_PHYSICS_DT, Capsule()),
        ACTION_SCALE * task.TORQUE_LIMIT,
    )
    torques = cycle(np.random.default_rng(0).uniform(-limit, limit, DRAWS).tolist())

    def step() -> None:
        if abs(mujoco.hold(model, data, next(torques))[0]) >= task.THETA_LIMIT:
            data.qpos[:], data.qvel[:] = (0.0, task.START_THETA), 0.0

    return step


def plain_c(
    compiler: str, simulation: Simulation
) -> tuple[Callable[[np.ndarray], object], np.ndarray]:
    """Copies environments of the speed task with direct torque, a multiple of the core's lanes,
    into plain C.

    Returns:
        Their `Simulation.step`, and the rows of `Simulation.world` before `Row.clock`.
    """
    level = {"v4": ("-march=native", "-mprefer-vector-width=512"), "v3": ("-march=x86-64-v3",)}.get(
        native.LEVEL, ()
    )
    options = (
        "-std=c99",
        "-O3",
        "-ffast-math",
        "-fPIC",
        *level,
        "-c",
        str(Path(__file__).with_name("plain.c")),
    )
    with tempfile.TemporaryDirectory() as folder:
        compiled, path = str(Path(folder, "plain.o")), str(Path(folder, "plain.so"))
        subprocess.run([*compiler.split(), *options, "-o", compiled], check=True)
        # Linked without -ffast-math, with which gcc makes the whole process lose subnormal numbers.
        subprocess.run([*compiler.split(), "-shared", compiled, "-lm", "-o", path], check=True)
        library = ctypes.CDLL(path)
    blocks, rows = len(simulation.world), ctypes.c_int.in_dll(library, "ROWS").value
    world, observations = (
        native.aligned_zeros((blocks, rows, LANES)),
        np.zeros((simulation.num_envs, 5), np.float32),
    )
    settings = np.array([getattr(simulation.settings, name) for name in C_SETTINGS.split()])
    first = world[:, : Row.clock]
    first[...] = simulation.world[:, : Row.clock]

    def step(actions: np.ndarray) -> None:
        b, q, u, out = (
            ctypes.c_void_p(native.address(each))
            for each in (world, settings, actions, observations)
        )
        library.step(b, blocks, q, u, out)

    return step, first


def from_the_start(compiler: str | None = None) -> tuple[Step, np.ndarray]:
    """Steps of the core, or with a compiler of plain C, always from the same states in episodes of
    `EPISODE` steps.

    Returns:
        The function and the rows of the environments that it changes, see `plain_c`.
    """
    simulation = Simulation(BATCH, EnvConfig(randomization="wide"))
    for i in range(BATCH):
        simulation.seed(i, i)
    simulation.reset(np.arange(BATCH))
    advance, world = (
        plain_c(compiler, simulation) if compiler else (simulation.step, simulation.world)
    )
    start = world.copy()
    torques = ACTION_SCALE * np.random.default_rng(0).uniform(-1.0, 1.0, (EPISODE, BATCH))
    actions = cycle(enumerate(torques))

    def step() -> None:
        n, action = next(actions)
        if n == 0:
            world[...] = start
        advance(action)

    return step, world


def contenders() -> dict[str, Callable[[], Step]]:
    """Functions that create what is measured; the number of environments is at the end of the names
    of batches.
    """
    endless: dict[str, Any] = {"max_episode_steps": sys.maxsize}
    found: dict[str, Callable[[], Step]] = {
        "capsule": partial(environment, ENV_ID),
        f"capsule, {BATCH}": partial(environment, ENV_ID, BATCH, **endless),
        f"capsule, law, {BATCH}": partial(environment, ENV_ID, BATCH, **LAW, **endless),
        f"capsule, 1 ms, {BATCH}": partial(
            environment, ENV_ID, BATCH, physics_dt=LAW_PHYSICS_DT, **endless
        ),
        "CartPole-v1": partial(environment, "CartPole-v1"),
        f"CartPole-v1, {BATCH}": partial(environment, "CartPole-v1", BATCH),
        "Pendulum-v1": partial(environment, "Pendulum-v1"),
        "capsule, reset": partial(environment, ENV_ID, reset=True),
        "CartPole-v1, reset": partial(environment, "CartPole-v1", reset=True),
        f"capsule, core, {BATCH}": lambda: from_the_start()[0],
    }
    if COMPILER:
        found[f"capsule, plain C, {BATCH}"] = lambda: from_the_start(COMPILER)[0]
    if find_spec("mujoco"):
        found["capsule, MuJoCo"] = mujoco_physics
    return found


def seconds_per_step(step: Step, environments: int) -> float:
    """Makes steps for `TURN_SECONDS`; returns the processor time of a step of one environment."""
    start, steps, seconds = time.process_time(), 0, 0.0
    while seconds < TURN_SECONDS:
        for _ in range(max(1, 64 // environments)):
            step()
            steps += environments
        seconds = time.process_time() - start
    return seconds / steps


def draw(measured: Mapping[str, float], stem: Path) -> None:
    """Draws the rates as bars on a logarithmic axis, those of this package in blue."""
    with style():
        figure = new_figure(0.24 * len(measured) + 0.6)
        axes = figure.add_subplot()
        names = [*measured][::-1]
        others = "CartPole", "Pendulum", "plain C", "MuJoCo"
        colours = [MUTED if any(other in name for other in others) else BLUE for name in names]
        bars = axes.barh(names, [measured[name] for name in names], color=colours, height=0.7)
        axes.bar_label(
            bars, [f"{measured[name]:,.0f}" for name in names], padding=3.0, fontsize=7.5
        )
        axes.set(
            xscale="log", xlim=(1e4, 3e7), xlabel="environment steps per second of processor time"
        )
        axes.grid(visible=False, axis="y")
        save(figure, stem)


@command(COMMAND, ValueError)
def main(
    markdown: Path | None = None, figure: Path | None = None, turns: PositiveCount = 30
) -> int:
    """Environment steps per second, and ratios to other environments and to plain C; fails if a
    ratio is too small.

    Plain C needs a compiler, MuJoCo the extra `bench`; what is not installed is left out.

    Examples:
      python -m benchmarks.throughput --markdown docs/speed_tables.md --figure docs/figures/speed
      CAPSULE_GYM_LEVEL=v3 CC=clang python -m benchmarks.throughput --turns 10

    Args:
        markdown: Write the table to this file.
        figure: Draw the rates as bars into files with this name, as SVG and PNG.
        turns: Measurements of every contender, in turns.
    """
    check_output("--markdown", markdown, overwrite=True)
    check_output("--figure", figure, overwrite=True)
    found = contenders()
    floors = {pair: floor for pair, floor in FLOORS.items() if set(pair) <= set(found)}
    sizes = {name: BATCH if name.endswith(f", {BATCH}") else 1 for name in found}
    seconds = {name: partial(seconds_per_step, make(), sizes[name]) for name, make in found.items()}
    measured = rates(seconds, turns)
    ratios = {pair: measured[pair[0]] / measured[pair[1]] for pair in floors}
    compared = {
        pair[0]: [f"{ratios[pair]:.2f}", pair[1], f"{floor:g}"] for pair, floor in floors.items()
    }
    table = [["", "env-steps/s", "ratio", "to", "at least"]]
    table += [
        [name, f"{rate:,.0f}", *compared.get(name, ["", "", ""])] for name, rate in measured.items()
    ]
    report(COMMAND, markdown, table, f"{machine()}.")
    if figure:
        draw(measured, figure)
    return int(any(ratios[pair] < floor for pair, floor in floors.items()))


if __name__ == "__main__":
    sys.exit(main())
