"""Environment steps per second, and their ratios: `python -m benchmarks.throughput`.

All actions are drawn beforehand. A single environment runs whole episodes, including resets. A
batch of this package does not truncate episodes, so that all batch sizes are comparable; an
environment that fails is reset within the step.

Contenders take turns, and the 10th percentiles of their processor times are used, so that other
processes have little effect. Unlike rates, ratios are comparable between machines. A ratio below
its floor usually means that the compiler vectorises a loop no longer.
"""

import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
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
# Number of distinct actions, which are repeated.
DRAWS = 256
# The same for a batch, each for all of its environments.
BATCH_DRAWS = 16
# Number of steps of an episode that begins at the same states.
EPISODE = 40
# Number of environments in most batches.
BATCH = 1024
# Steps between readings of the clock.
UNTIMED = 64

# Makes one step of all environments, or a reset of one.
Step = Callable[[], object]
# The command of the C compiler, its options, and further ones for the core's level.
COMPILER = os.environ.get("CC") or shutil.which("cc")
C_OPTIONS = ("-std=c99", "-O3", "-ffast-math", "-fPIC")
C_LEVELS = {
    "v4": ("-march=native", "-mprefer-vector-width=512"),
    "v3": ("-march=x86-64-v3",),
}
# The settings of plain C, in its order.
C_SETTINGS = (
    "m",
    "l",
    "g",
    "k",
    "c",
    "static_ratio",
    "backward_ratio",
    "torque_limit",
    "physics_dt",
    "energy_weight",
    "termination_penalty",
    "stick_threshold",
)
# The smallest ratio of two contenders' rates.
FLOORS = {
    ("capsule", "CartPole-v1"): 1.3,
    ("capsule, reset", "CartPole-v1, reset"): 0.25,
    ("capsule, 1024", "CartPole-v1, 1024"): 0.2,
    ("capsule, law, 1024", "capsule, 1 ms, 1024"): 0.46,
    ("capsule, core, 1024", "capsule, plain C, 1024"): 0.65,
}


def environment(env_id: str, *, reset: bool = False) -> Step:
    """Steps or resets of one environment with gymnasium's default wrappers."""
    env: Any = gym.make(env_id)
    env.reset(seed=0)
    actions = draw_actions(env.action_space, DRAWS)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return env.reset if reset else step


def batch(env_id: str, **kwargs: Any) -> Step:
    """Steps of a native batch of `BATCH` environments."""
    env: Any = gym.make_vec(
        env_id, num_envs=BATCH, vectorization_mode="vector_entry_point", **kwargs
    )
    env.reset(seed=0)
    actions = draw_actions(env.action_space, BATCH_DRAWS)
    return lambda: env.step(next(actions))


def draw_actions(space: Any, count: int) -> Iterator[Any]:
    """Repeats random actions; torques are scaled by `ACTION_SCALE`."""
    space.seed(0)
    actions = [space.sample() for _ in range(count)]
    if np.asarray(actions[0]).dtype.kind != "i":
        actions = [np.float32(ACTION_SCALE) * action for action in actions]
    return cycle(actions)


def mujoco_physics() -> Step:
    """The physics of one capsule in MuJoCo under random torques.

    It restarts where its ball meets the platform.
    """
    model, data = mujoco.build("frictionloss", DIRECT_PHYSICS_DT, Capsule())
    limit = ACTION_SCALE * task.TORQUE_LIMIT
    torques = cycle(np.random.default_rng(0).uniform(-limit, limit, DRAWS))

    def step() -> None:
        theta = mujoco.hold(model, data, next(torques))[0]
        if abs(theta) >= task.THETA_LIMIT:
            data.qpos[:] = 0.0, task.START_THETA
            data.qvel[:] = 0.0

    return step


def compile_c(compiler: str, source: Path, options: Sequence[str]) -> ctypes.CDLL:
    """Compiles a C file for the core's level of instructions."""
    options = [*options, *C_LEVELS.get(native.LEVEL, ())]
    with tempfile.TemporaryDirectory() as folder:
        compiled = f"{folder}/plain.o"
        library = f"{folder}/plain.so"
        command = compiler.split()
        subprocess.run([*command, *options, "-c", str(source), "-o", compiled], check=True)
        # Linked without -ffast-math, with which gcc makes the whole process lose subnormal numbers.
        subprocess.run([*command, "-shared", compiled, "-lm", "-o", library], check=True)
        return ctypes.CDLL(library)


def plain_c(
    compiler: str, simulation: Simulation
) -> tuple[Callable[[np.ndarray], object], np.ndarray]:
    """Copies environments of the speed task with direct torque into plain C.

    Args:
        compiler: the command of the C compiler.
        simulation: the environments, a multiple of the core's lanes.

    Returns:
        Their `Simulation.step`, and the rows of `Simulation.world` before `Row.clock`.
    """
    library = compile_c(compiler, Path(__file__).with_name("plain.c"), C_OPTIONS)
    blocks = len(simulation.world)
    rows = ctypes.c_int.in_dll(library, "ROWS").value
    world = native.aligned_zeros((blocks, rows, LANES))
    settings = np.array([getattr(simulation.settings, name) for name in C_SETTINGS])
    observations = np.zeros((simulation.num_envs, 5), np.float32)
    copied = world[:, : Row.clock]
    copied[...] = simulation.world[:, : Row.clock]

    def pointer(array: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(native.address(array))

    def step(actions: np.ndarray) -> None:
        arrays = map(pointer, (settings, actions, observations))
        library.step(pointer(world), blocks, *arrays)

    return step, copied


def from_the_start(compiler: str | None = None) -> tuple[Step, np.ndarray]:
    """Steps of the core or, with a compiler, of plain C, in episodes from the same states.

    Returns:
        The function and the rows of the environments that it changes, see `plain_c`.
    """
    simulation = Simulation(BATCH, EnvConfig(randomization="wide"))
    for i in range(BATCH):
        simulation.seed(i, i)
    simulation.reset(np.arange(BATCH))
    advance: Callable[[np.ndarray], object] = simulation.step
    world = simulation.world
    if compiler:
        advance, world = plain_c(compiler, simulation)
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
    """Functions that create what is measured.

    The number of environments is at the end of the names of batches.
    """
    capsules = partial(batch, ENV_ID, max_episode_steps=sys.maxsize)
    found: dict[str, Callable[[], Step]] = {}
    found["capsule"] = partial(environment, ENV_ID)
    found[f"capsule, {BATCH}"] = capsules
    found[f"capsule, law, {BATCH}"] = partial(capsules, **LAW)
    found[f"capsule, 1 ms, {BATCH}"] = partial(capsules, physics_dt=LAW_PHYSICS_DT)
    found["CartPole-v1"] = partial(environment, "CartPole-v1")
    found[f"CartPole-v1, {BATCH}"] = partial(batch, "CartPole-v1")
    found["Pendulum-v1"] = partial(environment, "Pendulum-v1")
    found["capsule, reset"] = partial(environment, ENV_ID, reset=True)
    found["CartPole-v1, reset"] = partial(environment, "CartPole-v1", reset=True)
    found[f"capsule, core, {BATCH}"] = lambda: from_the_start()[0]
    if COMPILER:
        found[f"capsule, plain C, {BATCH}"] = lambda: from_the_start(COMPILER)[0]
    if find_spec("mujoco"):
        found["capsule, MuJoCo"] = mujoco_physics
    return found


def seconds_per_step(step: Step, environments: int) -> float:
    """Makes steps for `TURN_SECONDS`; returns the processor time of a step of one environment."""
    start = time.process_time()
    seconds, steps = 0.0, 0
    while seconds < TURN_SECONDS:
        for _ in range(max(1, UNTIMED // environments)):
            step()
            steps += environments
        seconds = time.process_time() - start
    return seconds / steps


def draw(measured: Mapping[str, float], stem: Path) -> None:
    """Draws the rates as bars on a logarithmic axis, those of this package in blue."""
    # From bottom to top.
    names = [*measured][::-1]
    found = [measured[name] for name in names]
    others = re.compile("CartPole|Pendulum|plain C|MuJoCo")
    colours = [MUTED if others.search(name) else BLUE for name in names]
    with style():
        figure = new_figure(0.24 * len(measured) + 0.6)
        axes = figure.add_subplot()
        bars = axes.barh(names, found, color=colours, height=0.7)
        axes.bar_label(bars, [f"{rate:,.0f}" for rate in found], padding=3.0, fontsize=7.5)
        label = "environment steps per second of processor time"
        axes.set(xscale="log", xlim=(1e4, 3e7), xlabel=label)
        axes.grid(visible=False, axis="y")
        save(figure, stem)


@command(COMMAND, ValueError)
def main(
    markdown: Path | None = None, figure: Path | None = None, turns: PositiveCount = 30
) -> int:
    """Environment steps per second, and ratios to other environments and to plain C.

    Fails if a ratio is too small. Plain C needs a compiler, MuJoCo the extra `bench`; what is not
    installed is left out.

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
    seconds = {}
    for name, make in contenders().items():
        size = BATCH if name.endswith(f", {BATCH}") else 1
        seconds[name] = partial(seconds_per_step, make(), size)
    measured = rates(seconds, turns)
    table = [["", "env-steps/s", "ratio", "to", "at least"]]
    failed = False
    for name, rate in measured.items():
        compared = ["", "", ""]
        for (first, other), floor in FLOORS.items():
            if first == name and other in measured:
                ratio = rate / measured[other]
                failed |= ratio < floor
                compared = [f"{ratio:.2f}", other, f"{floor:g}"]
        table.append([name, f"{rate:,.0f}", *compared])
    report(COMMAND, markdown, table, f"{machine()}.")
    if figure:
        draw(measured, figure)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
